import assert from "node:assert/strict";
import { test } from "node:test";
import { answers, asked, page } from "./setup.mjs";

sessionStorage.setItem("needle-rig-token", "secret");
const { access, ask, picture, save, whyNot } = await page("net.js");

/** Ways to ask: each tells a refusal in the same sentence. */
const WAYS = { ask: () => ask("GET", "x"), picture: () => picture("x"), save: () => save("x", "x.csv") };
const NO_JSON = Symbol("a page of the proxy's own");

/** The sentence of what is refused. */
async function told(way) {
  return way().then(() => assert.fail("it is not refused"), (error) => error.message);
}

test("a proxy that answers for a server that is gone or slow is told as what it is", async () => {
  for (const status of [502, 504])
    for (const [name, way] of Object.entries(WAYS)) {
      answers.set("GET /api/x", [status, NO_JSON]);
      assert.equal(await told(way), `The page's server does not answer. Start it again: needle-rig web. Its proxy said ${status}.`, name);
    }
  assert.equal(access.value, "in"); // the key is not in doubt
});

test("while a proxy answers for it, the reason that nothing comes from the server says so", async () => {
  answers.set("GET /api/session", [504, NO_JSON]);
  assert.match(await whyNot(), /does not answer.* Its proxy said 504/);
});

test("another page of a proxy is told by its number, and never as a fault of this page", async () => {
  for (const status of [413, 500, 503])
    for (const [name, way] of Object.entries(WAYS)) {
      answers.set("GET /api/x", [status, NO_JSON]);
      const sentence = await told(way);
      assert.match(sentence, new RegExp(`answered ${status}\\.`), name);
      assert.doesNotMatch(sentence, /JSON|undefined|token/i, name);
    }
});

test("the server's own sentence comes through as it is", async () => {
  for (const [name, way] of Object.entries(WAYS)) {
    answers.set("GET /api/x", [507, { error: "a.csv: make room" }]);
    assert.equal(await told(way), "a.csv: make room", name);
  }
});

test("no answer at all, and the key goes with each question", async () => {
  answers.delete("GET /api/x");
  assert.equal(await told(WAYS.ask), "no such path");
  assert.equal(asked.at(-1).headers.Authorization, "Bearer secret");
  const before = globalThis.fetch;
  globalThis.fetch = () => Promise.reject(new TypeError("Failed to fetch"));
  assert.equal(await told(WAYS.ask), "The page's server does not answer. Start it again: needle-rig web.");
  globalThis.fetch = before;
});
