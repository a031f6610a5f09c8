import assert from "node:assert/strict";
import { test } from "node:test";
import { answers, asked, page, settled } from "./setup.mjs";

const { begin, done, jobs, result } = await page("jobs.js");
const { said } = await page("store.js");

const job = (state, more = {}) => ({ key: "k", kind: "compare", data: [], model: null, asked: {}, state, step: "", done: 0, total: 0, name: "", added: [], error: "", left_s: null, ...more });

test("a job is followed to its end, which its asker alone hears", async () => {
  answers.set("POST /api/jobs", [202, { job: "k" }]);
  answers.set("GET /api/jobs", [200, { jobs: [job("running")] }]);
  const end = done({ kind: "compare" });
  await settled();
  assert.equal(jobs.value[0].state, "running");
  answers.set("GET /api/jobs", [200, { jobs: [job("done")] }]);
  assert.equal((await end).state, "done");
});

test("a job that failed says why, one that was cancelled says nothing", async () => {
  for (const [state, error] of [["failed", "no data"], ["cancelled", ""]]) {
    answers.set("GET /api/jobs", [200, { jobs: [job(state, { error })] }]);
    assert.equal(await done({ kind: "compare" }), null);
    assert.equal(said.value, error);
  }
});

test("what the server refuses to begin is its sentence and no key", async () => {
  answers.set("POST /api/jobs", [422, { error: "no data was chosen" }]);
  assert.equal(await begin({ kind: "compare" }), null);
  assert.equal(said.value, "no data was chosen");
});

test("a result is asked for once, and again after it could not be had", async () => {
  const times = () => asked.filter((one) => one.path === "/api/jobs/r").length;
  await assert.rejects(result("r"));
  await settled();
  answers.set("GET /api/jobs/r", [200, { ...job("done"), asked: { quick: true }, result: { name: "mine" } }]);
  assert.deepEqual(await result("r"), { name: "mine", key: "r", asked: { quick: true } });
  await result("r");
  assert.equal(times(), 2);
  setTimeout(() => process.exit(), 0); // the client goes on to follow jobs
});
