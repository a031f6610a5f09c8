// What the model of a run expects, as it comes while the run goes on: beside the measurement, and ahead of it.
import { distance, html, signal, words } from "./ui.js";

/** Times with the mean and the standard deviation of each channel: torque / N·mm, then each Hall angle / °.
 * @typedef {{time_s: number[], mean: number[][], deviation: number[][]}} Course */
/** As the server tells it: a piece of a run, how many standard deviations each channel is off, and what comes next.
 * @typedef {Course & {run: string, off: number[], ahead: Course | null, band_sigma: number, alarm_sigma: number, refused?: string}} Told */
/** @typedef {{run: string, past: Course, ahead: Course | null, off: number[], left: string[], band_sigma: number, alarm_sigma: number, refused: string}} Expected */

/** @type {{value: Expected | null}} */
export const expected = signal(null);

/** @param {Told} told */
export function hear(told) {
  const before = expected.value?.run === told.run ? expected.value : null;
  if (told.refused) {
    expected.value = { run: told.run, past: { time_s: [], mean: [], deviation: [] }, ahead: null, off: [], left: [], band_sigma: 0, alarm_sigma: 0, refused: told.refused };
    return;
  }
  /** @param {number[][]} old @param {number[][]} now */
  const more = (old, now) => now.map((values, k) => (old[k] ?? []).concat(values));
  // a piece without a time, as the last one of a run, has no channels either
  const past = before && !told.time_s.length ? before.past : before ? { time_s: before.past.time_s.concat(told.time_s), mean: more(before.past.mean, told.mean), deviation: more(before.past.deviation, told.deviation) } : told;
  // the first time that a channel leaves the band is said until the next run
  const left = [...(before?.left ?? [])];
  told.off.forEach((off, k) => {
    const channel = k ? `Hall angle ${k}` : "torque";
    if (Math.abs(off) > told.alarm_sigma && !left.some((text) => text.startsWith(channel)))
      left.push(`${channel} ${distance(off, "above", "below")}`);
  });
  expected.value = { run: told.run, past, ahead: told.ahead, off: told.off, left, band_sigma: told.band_sigma, alarm_sigma: told.alarm_sigma, refused: "" };
}

/** Forget the run before, when another order begins. */
export const forget = () => (expected.value = null);

/** A value between two dots; null outside of them. @param {number[]} times @param {number[]} values @param {number} at */
function between(times, values, at) {
  if (!times.length || at < times[0] || at > times[times.length - 1]) return null;
  let low = 0;
  let high = times.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= at) low = middle;
    else high = middle;
  }
  const span = times[high] - times[low];
  return span > 0 ? values[low] + ((at - times[low]) / span) * (values[high] - values[low]) : values[low];
}

/** Of channel `k`, the mean and both edges of the band at these times and then ahead: rows for a plot whose times go on with `ahead`.
 * @param {Expected} of @param {number} k @param {number[]} times */
export function laid(of, k, times) {
  /** @param {(course: Course) => number[]} rows */
  const row = (rows) => [...times.map((at) => between(of.past.time_s, rows(of.past), at)), ...(of.ahead ? rows(of.ahead) : [])];
  /** @param {number} side @returns {(course: Course) => number[]} */
  const edge = (side) => (course) => (course.mean[k] ?? []).map((value, i) => value + side * of.band_sigma * course.deviation[k][i]);
  return [row((course) => course.mean[k] ?? []), row(edge(1)), row(edge(-1))];
}

/** That the sensors are not as the model expects them. @param {{model: string | null}} props */
export function Alarm({ model }) {
  const of = expected.value;
  if (!of) return null;
  if (of.refused) return html`<p class="quiet">Nothing is predicted: ${of.refused}.</p>`;
  if (!of.left.length) return null;
  return html`<p class="refusal" role="alert"><span><strong>The needle is not as the model ${words(model ?? "")} expects:</strong> ${of.left.join(", ")}.
    The limit is ${of.alarm_sigma} σ over one second. The run goes on; stop it if this surprises you, and diagnose it.</span></p>`;
}
