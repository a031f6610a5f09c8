// What a first visit shows: the rig and its parts, what windup is, and data to try all of it with.
import { Working, done, jobs } from "./jobs.js";
import { dataOf, dataRoute, look } from "./store.js";
import { html } from "./ui.js";

/** Data of a simulated needle that has what the null model lacks, then the workbench with them. */
async function example() {
  const job = await done({ kind: "example" });
  if (!job) return;
  await look();
  const data = dataOf(`imported:${job.key}`);
  if (data) location.hash = dataRoute([data]);
}

/** @type {[number, number, string, string][]} */
const PARTS = [
  [64, 60, "motor", "turns the base"],
  [150, 60, "torque cell", "measures the torque at the base"],
  [285, 60, "guide", "holds the shaft straight"],
  [560, 60, "tissue", "rubs along the shaft"],
  [860, 60, "tip", "lags behind the base"],
];

/** The rig, its parts and what they do. */
export function Opening() {
  return html`<section class="card wide opening"><h2>What this is about</h2>
    <p>A motor turns a long flexible needle at its base. Tissue rubs along the shaft, so that the shaft twists and the tip stays behind: that is <strong>windup</strong>.
      The rig measures torque and angles, learns why the tip lags, and turns the base so that the tip points where it should.</p>
    <svg class="rig" viewBox="0 0 900 150" role="img" aria-label="The rig: a motor turns the base of the needle, through a torque cell and a guide; the shaft runs through tissue to its tip, and Hall sensors measure its angle">
      <line class="needle" x1="90" x2="850" y1="90" y2="90" />
      <rect class="part" x="30" y="68" width="68" height="44" rx="6" /><rect class="part" x="126" y="76" width="48" height="28" rx="4" /><rect class="part" x="262" y="78" width="46" height="24" />
      ${[440, 560, 680].map((x) => html`<rect class="tissue" x=${x - 30} y="70" width="60" height="40" />`)}
      ${[380, 500, 620, 740].map((x) => html`<path class="mark" d=${`M${x} 96 l-6 11 h12 z`} />`)}
      <path class="needle" d="M850 90 l22 -5 v10 z" />
      ${PARTS.map(([x, , name]) => html`<text x=${x} y="48" text-anchor="middle">${name}</text>`)}
      <text x="560" y="132" text-anchor="middle">Hall sensors measure the angle along the shaft</text></svg>
    <dl class="settings">${PARTS.map(([, , name, does]) => html`<div><dt>${name}</dt><dd>${does}</dd></div>`)}<div><dt>Hall sensors</dt><dd>measure the angle along the shaft</dd></div></dl>
    <${Working} kinds=${["example"]} of=${jobs.value} />
    <p class="buttons"><button class="go" onClick=${example}>Try it with example data</button>
      <span class="quiet">A simulated series, with an effect that the first model lacks: find it, add it, and use the new model on a rig.</span></p></section>`;
}
