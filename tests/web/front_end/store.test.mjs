import assert from "node:assert/strict";
import { test } from "node:test";
import { answers, asked, page, settled } from "./setup.mjs";

const { about, dataRoute, heldModel, look, lost, modelCalled, place, placeOf, route, said, subject } = await page("store.js");
const { access, watching } = await page("net.js");

const MINE = { key: "data:data/mine", name: "data/mine", kind: "dataset" };
const LEARNT = { key: "k1", name: "learnt", added: ["tissue_elasticity"] };
const ABOUT = { data: [MINE], models: [LEARNT], parameters: ["rig_soft"], strategies: [], rig_model: null };

test("an address is a view, a name and a query, and a route gives it back", () => {
  const names = ["mine", "data/mine", "ä b/100 %?#", "<img>"];
  for (const name of names) {
    const { view, name: read, query } = placeOf(route("data", name, [["model", "a&b"]]));
    assert.deepEqual([view, read, query.get("model")], ["data", name, "a&b"]);
  }
  assert.equal(placeOf("").view, "live");
  assert.equal(placeOf("#/runs/100%").name, "100%"); // no encoding, taken as it is
});

test("data and model of the address are the subject, under one id", () => {
  about.value = ABOUT;
  location.hash = dataRoute([MINE], LEARNT);
  assert.deepEqual(subject.value.data, [{ key: MINE.key, name: MINE.name }]);
  assert.deepEqual(subject.value.model, { key: "k1", name: "learnt" });
  const of = subject.value.id;
  location.hash = dataRoute([MINE]);
  assert.notEqual(subject.value.id, of);
  assert.equal(heldModel.value, null);
});

test("recorded runs are a subject of several data", () => {
  location.hash = dataRoute([{ key: "run:a", name: "a" }, { key: "run:b", name: "b" }]);
  assert.deepEqual(subject.value.data.map((one) => one.key), ["run:a", "run:b"]);
});

test("what is not there is a sentence and no subject", () => {
  for (const [address, word] of [["#/data/nothing", "no such data"], ["#/data/data/mine?model=nothing", "no such model"]]) {
    location.hash = address;
    assert.match(lost.value, new RegExp(word));
    assert.equal(subject.value, null);
  }
});

test("another view has no subject, and a new place clears what was refused", () => {
  said.value = "refused";
  location.hash = "#/runs";
  assert.equal(subject.value, null);
  assert.equal(said.value, "");
  assert.equal(place.value.view, "runs");
});

test("a model is called by its name, a parameter set by its own", () => {
  assert.deepEqual(modelCalled("learnt"), { key: "k1", name: "learnt" });
  assert.deepEqual(modelCalled("rig_soft"), { key: "rig_soft", name: "rig_soft" });
  assert.equal(modelCalled(""), null);
  assert.equal(modelCalled("nothing"), undefined);
});

test("without a token nothing is asked; the token of the address opens a session and is shown to nobody", async () => {
  assert.equal(access.value, "incomplete");
  answers.set("POST /api/session", [200, { page: "half", watches: true }]);
  answers.set("GET /api/about", [200, ABOUT]);
  location.hash = "#token=secret";
  await settled();
  assert.equal(access.value, "in");
  assert.equal(watching.value, true);
  assert.equal(asked.at(-1).headers.Authorization, "Bearer secret");
  assert.equal(localStorage.getItem("needle-rig-page"), "half");
  assert.equal(sessionStorage.getItem("needle-rig-token"), null);
  await look();
  assert.deepEqual(about.value, ABOUT);
});

test("a key that the server does not know is told as what it is, a refusal as its sentence", async () => {
  answers.set("GET /api/about", [403, { error: "may watch" }]);
  await look();
  assert.deepEqual([said.value, access.value], ["may watch", "in"]);
  answers.set("GET /api/about", [401, { error: "x" }]);
  await look();
  assert.match(said.value, /no longer valid/);
  assert.equal(access.value, "stale");
});
