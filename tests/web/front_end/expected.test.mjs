import assert from "node:assert/strict";
import { test } from "node:test";
import { page } from "./setup.mjs";

const { expected, forget, hear, laid } = await page("expected.js");

/** A piece of a run: torque and one Hall angle. */
const piece = (times, more = {}) => ({
  run: "a", time_s: times, mean: times.length ? [times.map((t) => t / 10), times.map((t) => 2 * t)] : [], deviation: times.length ? [times.map(() => 0.1), times.map(() => 0.5)] : [],
  off: [0, 0], ahead: null, band_sigma: 2, alarm_sigma: 5, ...more,
});

test("pieces of one run go on, and the last one, which is empty, takes nothing away", () => {
  hear(piece([0, 1]));
  hear(piece([2, 3]));
  hear(piece([]));
  assert.deepEqual(expected.value.past.time_s, [0, 1, 2, 3]);
  const [mean, upper, lower] = laid(expected.value, 1, [-1, 0.5, 3]);
  assert.deepEqual([mean, upper, lower], [[null, 1, 6], [null, 2, 7], [null, 0, 5]]);
});

test("another run begins anew, and an order forgets", () => {
  hear(piece([7], { run: "b" }));
  assert.deepEqual(expected.value.past.time_s, [7]);
  forget();
  assert.equal(expected.value, null);
});

test("a channel that leaves its band is told once, as it left", () => {
  hear(piece([0], { run: "c", off: [6, -7.5] }));
  hear(piece([1], { run: "c", off: [9, 0] }));
  assert.deepEqual(expected.value.left, ["torque 6.0 σ above", "Hall angle 1 7.5 σ below"]);
});

test("what cannot be predicted says why and draws nothing", () => {
  hear(piece([0], { run: "d", refused: "the model is of another shaft" }));
  assert.equal(expected.value.refused, "the model is of another shaft");
  assert.deepEqual(laid(expected.value, 0, [0, 1]), [[null, null], [null, null], [null, null]]);
});
