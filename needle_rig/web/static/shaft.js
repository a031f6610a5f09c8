// The shaft along its length: tissue, sensors, measured angles, the estimate between them and its uncertainty.
import { html, number, signal } from "./ui.js";

// on a narrow screen the same height is drawn with fewer units across, so that text stays readable
const narrow = matchMedia("(max-width: 760px)");
const width = signal(0);
const measure = () => (width.value = narrow.matches ? 460 : 1000);
narrow.addEventListener("change", measure);
measure();
const HEIGHT = 250;
const LEFT = 52;
const RIGHT = 20;
const TOP = 14;
const GROUND = 190;
const STEP_DEG = 15;
/** What a person reads for the state of the drive. After boot it takes no command until an order clears it.
 * `running` is the drive's word for a command that is in force, at a stand, too. @param {import("./live.js").State} state */
function driveSaid({ sensors, phase }) {
  const said = sensors?.drive_state ?? "";
  if (said === "silent") return "waits for the first order";
  if (said !== "running") return said;
  return phase === "moving" ? "turns the base" : "holds the base";
}

/** @param {{state: import("./live.js").State, estimate: import("./types").EstimateDocument | null}} props */
export function Shaft({ state, estimate }) {
  const { rig, sensors, target_deg: target } = state;
  if (!sensors) return html`<p class="quiet">No reading yet.</p>`;
  const readings = [sensors.base_deg, sensors.torque_nmm, ...sensors.hall_deg];
  const whole = readings.every((r) => r !== null);
  const curve = estimate && whole && estimate.gain_deg[0].length === readings.length
    ? estimate.gain_deg.map((/** @type {number[]} */ row) => row.reduce((sum, g, k) => sum + g * Number(readings[k]), 0)) : null;
  /** @type {Point[]} */
  const points = [[0, sensors.base_deg], ...rig.hall_positions_mm.map((p, k) => /** @type {Point} */ ([p, sensors.hall_deg[k]]))];
  return html`<${ShaftPicture} rig=${rig} points=${points} target=${target} curve=${curve}
      places=${estimate?.places_mm} deviation=${estimate?.deviation_deg} />
    <dl class="readings">
      <div><dt>base</dt><dd>${number(sensors.base_deg, 2)}°</dd></div>
      <div><dt>torque</dt><dd>${number(sensors.torque_nmm, 4)} N·mm</dd></div>
      ${sensors.hall_deg.map((a, k) => html`<div><dt>hall ${k + 1}</dt><dd>${number(a, 1)}°</dd></div>`)}
      ${curve && estimate ? html`<div><dt>tip, estimated</dt><dd>${number(curve.at(-1), 1)}° ± ${number(2 * (estimate.deviation_deg.at(-1) ?? NaN), 1)}°</dd></div>` : null}
      <div><dt>drive</dt><dd>${driveSaid(state)}</dd></div>
    </dl>`;
}

/** What is drawn of a rig. @typedef {Pick<import("./types").Rig, "needle_length_mm" | "tissue_sections_mm" | "hall_positions_mm">} Drawn */
/** A place / mm with the angle that is known there / °. @typedef {[number, number | null]} Point */
/** @param {{rig: Drawn, points: Point[], target: number | null, curve: number[] | null, places?: number[], deviation?: number[]}} props */
export function ShaftPicture({ rig, points, target, curve, places, deviation }) {
  const WIDTH = width.value;
  const values = [...points.map((p) => p[1]), ...(curve ?? []), target ?? 0, 0].filter((v) => v !== null);
  const low = STEP_DEG * Math.floor((Math.min(...values) - 2) / STEP_DEG);
  const high = Math.max(STEP_DEG * Math.ceil((Math.max(...values) + 2) / STEP_DEG), low + 2 * STEP_DEG);
  /** @param {number} mm */
  const x = (mm) => LEFT + (mm / rig.needle_length_mm) * (WIDTH - LEFT - RIGHT);
  /** @param {number} angle */
  const y = (angle) => TOP + ((high - angle) / (high - low)) * (GROUND - TOP - 14);
  const every = Math.max(STEP_DEG, STEP_DEG * Math.ceil((high - low) / STEP_DEG / 5));
  const ticks = [];
  for (let t = Math.ceil(low / every) * every; t <= high; t += every) ticks.push(t);
  const at = places ?? [];
  /** @param {number} side */
  const edge = (side) => (curve ?? []).map((a, k) => `${x(at[k]).toFixed(1)},${y(a + side * 2 * (deviation?.[k] ?? 0)).toFixed(1)}`);
  const path = curve ? curve.map((a, k) => `${x(at[k]).toFixed(1)},${y(a).toFixed(1)}`).join(" ") : "";
  const said = points.map(([p, a], k) => `${k ? `hall ${k} at ${p} mm` : "base"} ${number(a, 1)}°`).join(", ");
  return html`<svg class="shaft" viewBox=${`0 0 ${WIDTH} ${HEIGHT}`} role="img" aria-label=${`Angle along the shaft: ${said}`}>
    ${rig.tissue_sections_mm.map((/** @type {number[]} */ [a, b]) => html`<rect class="tissue" x=${x(a)} y=${TOP} width=${x(b) - x(a)} height=${GROUND - TOP + 16} />`)}
    ${ticks.map((t) => html`<line class="grid" x1=${LEFT} x2=${WIDTH - RIGHT} y1=${y(t)} y2=${y(t)} />
      <text class="tick" x=${LEFT - 8} y=${y(t) + 4} text-anchor="end">${number(t, 0)}°</text>`)}
    ${target !== null && target !== undefined ? html`<line class="target" x1=${LEFT} x2=${WIDTH - RIGHT} y1=${y(target)} y2=${y(target)} />` : null}
    ${curve && deviation ? html`<polygon class="band" points=${[...edge(1), ...edge(-1).reverse()].join(" ")} />` : null}
    ${curve ? html`<polyline class="curve" points=${path} />` : null}
    ${points.filter((p) => p[1] !== null).map(([p, a], k) => html`<circle class=${k ? `sensor f${k}` : "base"} cx=${x(p)} cy=${y(Number(a))} r="6" />`)}
    <rect class="needle" x=${x(0)} y=${GROUND + 4} width=${x(rig.needle_length_mm) - x(0)} height="3" />
    <rect class="chuck" x=${x(0) - 6} y=${GROUND - 3} width="14" height="17" />
    ${rig.tissue_sections_mm.map((/** @type {number[]} */ [a, b]) => html`<rect class="block" x=${x(a)} y=${GROUND - 2} width=${x(b) - x(a)} height="15" />`)}
    ${rig.hall_positions_mm.map((/** @type {number} */ p, /** @type {number} */ k) => html`<path class="mark" d=${`M${x(p)} ${GROUND + 9} l-5 9 h10 z`} />
      <text class="tick" x=${x(p)} y=${GROUND + 31} text-anchor="middle">${k + 1}</text>`)}
    <text class="tick" x=${x(0)} y=${GROUND + 31}>base</text>
    ${(WIDTH < 1000 ? [0, 200, 400] : [0, 100, 200, 300, 400]).filter((mm) => mm <= rig.needle_length_mm).map((mm) => html`<text class="tick" x=${x(mm)} y=${HEIGHT - 6} text-anchor="middle">${mm}${mm ? "" : " mm"}</text>`)}
    <text class="tick" x=${WIDTH - RIGHT} y=${GROUND - 8} text-anchor="end">tip</text></svg>
  <p class="key"><span class="pair"><span class="k base"></span>base</span> ${points.length > 1 ? html`<span class="pair"><span class="k sensor"></span>Hall sensors</span>` : null}
    ${curve ? html`<span class="pair"><span class="k curve"></span>${deviation ? "estimate ± 2σ" : "shaft"}</span>` : null}
    <span class="pair"><span class="k tissue"></span>tissue</span> ${target !== null && target !== undefined ? html`<span class="pair"><span class="k target"></span>target</span>` : null}</p>`;
}
