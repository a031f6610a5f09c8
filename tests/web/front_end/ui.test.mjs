import assert from "node:assert/strict";
import { test } from "node:test";
import { page } from "./setup.mjs";

const { distance, plain } = await page("ui.js");

// sentences of the program beside what the page tells of them
const TOLD = [
  ["not aligned: the tip lags 12°; the model may lack an effect: needle-rig diagnose runs/a b.h5", "not aligned: the tip lags 12°; the model may lack an effect"],
  ["the emergency stop is pressed; release it, then: needle-rig clear Also: the torque node is silent", "the emergency stop is pressed; release it, then clear Also: the torque node is silent"],
  ["check the stage (if you turned it by hand, `needle-rig release` it first), then: needle-rig clear", "check the stage (if you turned it by hand, release it first), then clear"],
  ["the zero is lost; find it again: needle-rig home --by hall, --by index, or --here ANGLE if you know it", "the zero is lost; find it again"],
  ["this rig has no Hall sensor to find its zero by; give --here, or --by index", "this rig has no Hall sensor to find its zero by"],
  ["a sequence is running; stop it first: needle-rig stop", "a sequence is running; stop it first"],
  ["its error was 5.0 times the noise floor, limit 3 (option largest_error); look for the missing effect (needle-rig diagnose), or choose reed2008", "its error was 5.0 times the noise floor, limit 3; look for the missing effect, or choose reed2008"],
  ["something has changed: torque; find out with: needle-rig diagnose a.h5 and the runs after it", "something has changed: torque"],
  ["reference period: 2 of 5 runs (1 runs are not judged: needle-rig watch --list)", "reference period: 2 of 5 runs (1 runs are not judged)"],
  ["what is missing cannot be told; the strategy planned turns all the same (needle-rig compensate --strategy planned --option use_hall=true)", "what is missing cannot be told; the strategy planned turns all the same"],
  // what no page can do stays, and so does what is no command
  ["no daemon answers at /run/rig; start one: needle-rig daemon", "no daemon answers at /run/rig; start one: needle-rig daemon"],
  ["needle-rig web was closed while this ran; start it again", "needle-rig web was closed while this ran; start it again"],
  ["version 9 is not known, this needle-rig reads 1; write 1 (one)", "version 9 is not known, this needle-rig reads 1; write 1 (one)"],
];

test("the page tells a sentence without the commands of a terminal", () => {
  for (const [sentence, told] of TOLD) assert.equal(plain(sentence), told);
});

test("a distance is a figure up to 8 σ, as the program's own sentences have it", () => {
  assert.equal(distance(2.54), "+2.5 σ");
  assert.equal(distance(-7.96), "−8.0 σ");
  assert.equal(distance(-2540), "beyond −8 σ");
  assert.equal(distance(-2540, "above", "below"), "more than 8 σ below");
  assert.equal(distance(6, "above", "below"), "6.0 σ above");
});
