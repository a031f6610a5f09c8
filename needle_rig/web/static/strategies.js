// The strategies on one's own model, and each planned sequence as a moving shaft.
import { Working, alive, begin, jobs, result } from "./jobs.js";
import { ask } from "./net.js";
import { ShaftPicture } from "./shaft.js";
import { about, modelCalled, place, refuse, route } from "./store.js";
import { Cells, Heads, computed, effect, html, number, signal, plain, untracked, typeset, useEffect, words, written, prose } from "./ui.js";

const targets = signal("45");
const seeds = signal("2");
/** A parameter set, where the address names no model that was learnt. */
const parameters = signal("rig_elastic");
/** @typedef {import("./types").StrategiesResult & {of: string | null, asked: {targets_deg: number[], seeds: number, parameters: string}}} Found */
/** @type {{value: Found | null}} */
const found = signal(null);
const name = signal("reed2008");
const step = signal(0);
const plays = signal(false);

/** The model of the address; null for a parameter set. */
const model = computed(() => (place.value.view === "strategies" && about.value ? modelCalled(place.value.query.get("model")) ?? null : null));
/** The work of this view, the newest last. */
const own = computed(() => jobs.value.filter((job) => job.kind === "strategies" && (job.model?.key ?? null) === (model.value?.key ?? null)));
const busy = computed(() => own.value.some(alive));

/** Take the newest table of this model. */
async function load() {
  const of = model.value?.key ?? null;
  try {
    const { strategies } = await ask("GET", `results?${new URLSearchParams(of ? [["model", of]] : [])}`);
    if (strategies?.state !== "done") return;
    const now = await result(strategies.key);
    if ((model.value?.key ?? null) !== of) return;
    found.value = { ...now, of };
    targets.value = now.asked.targets_deg.join(", ");
    seeds.value = String(now.asked.seeds);
    parameters.value = now.asked.parameters;
    step.value = 0;
    plays.value = false;
    if (!now.sequences[name.value]) name.value = Object.keys(now.sequences)[0] ?? "";
  } catch (error) {
    refuse(error);
  }
}
const stand = computed(() => JSON.stringify([place.value.view, Boolean(about.value), model.value?.key, own.value.map((job) => [job.key, job.state])]));
effect(() => {
  void stand.value;
  if (untracked(() => place.value.view === "strategies" && about.value)) untracked(load);
});

function run() {
  const angles = targets.value.split(/[\s,;]+/).filter(Boolean).map(Number);
  return begin({ kind: "strategies", model: model.value?.key ?? null, parameters: parameters.value, targets_deg: angles, seeds: Number(seeds.value) });
}

export function Strategies() {
  const shown = found.value && found.value.of === (model.value?.key ?? null);
  const all = about.value?.models ?? [];
  return html`<h1>Strategies</h1><p class="purpose">Try each way of aligning the needle on one simulated needle with noise.</p>
    <section class="card"><form class="orders" onSubmit=${(/** @type {Event} */ e) => { e.preventDefault(); if (!busy.value) run(); }}>
      <label>Needle <select value=${model.value?.name ?? parameters.value} onChange=${(/** @type {Event} */ e) => {
        const learnt = all.some((m) => m.name === written(e));
        if (!learnt) parameters.value = written(e);
        location.hash = route("strategies", "", learnt ? [["model", written(e)]] : []);
      }}>${all.map((m) => html`<option value=${m.name} selected=${m.name === model.value?.name}>${words(m.name)} (learnt)</option>`)}
        ${(about.value?.parameters ?? []).map((/** @type {string} */ p) => html`<option value=${p} selected=${!model.value && p === parameters.value}>${words(p)}</option>`)}</select></label>
      <label>Targets / ° <input value=${targets.value} onInput=${(/** @type {Event} */ e) => (targets.value = written(e))} /></label>
      <label>Runs of each kind <input type="number" min="1" max="10" value=${seeds.value} onInput=${(/** @type {Event} */ e) => (seeds.value = written(e))} /></label>
      <button class="go" aria-disabled=${busy.value}>Run every strategy</button></form>
      <${Working} kinds=${["strategies"]} of=${own.value} />
    </section>
    ${shown ? html`<${Table} found=${found.value} /><${Moving} found=${found.value} />` : html`<${Known} />`}`;
}

/** What a strategy does, in a sentence. @param {string} strategy */
const told = (strategy) => (about.value?.strategies.find((s) => s.name === strategy)?.text ?? "");

/** What there is to try, before it was tried. */
function Known() {
  return html`<section class="card"><h2>What is tried</h2><p class="quiet">Each strategy turns the base in its own sequence. The table will have the error, the lag of the tip, torque and time of each, and its sequence as a moving shaft.</p>
    <dl class="known">${(about.value?.strategies ?? []).map((each) => html`<div><dt>${words(each.name)}</dt><dd>${typeset(each.text)}</dd></div>`)}</dl></section>`;
}

/** What the table has of each strategy. */
const MEASURES = ["worst error / °", "tip lag / °", "mean error / °", "torque / N·mm", "rotations", "time / s"];

/** @param {{found: Found}} props */
function Table({ found }) {
  const rows = [...found.rows].sort((a, b) => (a.worst_deg?.median ?? Infinity) - (b.worst_deg?.median ?? Infinity));
  /** @param {{median: number, q95: number} | null | undefined} e @param {number} d */
  const both = (e, d) => (e ? (found.asked.seeds > 1 ? `${number(e.median, d)} (${number(e.q95, d)})` : number(e.median, d)) : "–");
  return html`<section class="card"><h2>Side by side</h2><p class="quiet">On ${words(found.of ? model.value?.name ?? "" : found.asked.parameters)}. ${found.asked.seeds > 1 ? "Medians, 95 % quantiles in brackets." : "One run of each kind."} Choose one to see its sequence.</p>
    <div class="scroll" tabindex="0" role="group" aria-label="Strategies"><table class="stacked numbers"><${Heads} of="strategy" names=${MEASURES} />
      <tbody>${rows.map((row) => html`<tr class=${row.strategy === name.value ? "named" : ""}><th scope="row"><button title=${prose(told(row.strategy))} aria-pressed=${row.strategy === name.value} disabled=${!found.sequences[row.strategy]}
          onClick=${() => { name.value = row.strategy; step.value = 0; }}>${words(row.strategy)}</button></th>
        ${row.refused && !row.worst_deg ? html`<td class="text" colspan="6">${plain(row.refused)}</td>` : html`<${Cells} names=${MEASURES} values=${[both(row.worst_deg, 1), both(row.tip_lag_deg, 1), both(row.mean_deg, 1), both(row.torque_nmm, 3), number(row.rotations, 0), number(row.time_s, 1)]} />`}</tr>`)}</tbody></table></div></section>`;
}

/** @param {{found: Found}} props */
function Moving({ found }) {
  const motions = found.sequences[name.value]?.motions;
  useEffect(() => {
    if (!plays.value || !motions) return undefined;
    const every = setInterval(() => {
      step.value = Math.min(step.value + 0.05, motions.length - 1);
      if (step.value >= motions.length - 1) plays.value = false;
    }, 33);
    return () => clearInterval(every);
  }, [plays.value, motions]);
  if (!motions) return null;
  const k = Math.min(Math.floor(step.value), motions.length - 1);
  const next = motions[Math.min(k + 1, motions.length - 1)];
  const part = step.value - k;
  /** @param {number} a @param {number} b */
  const mix = (a, b) => a + part * (b - a);
  const curve = motions[k].shaft_deg.map((/** @type {number} */ a, /** @type {number} */ i) => mix(a, next.shaft_deg[i]));
  return html`<section class="card"><h2>${words(name.value)} to ${found.target_deg}°</h2>
    <p>${typeset(told(name.value))}</p>
    <${ShaftPicture} rig=${found} points=${[[0, curve[0]]]} target=${found.target_deg} curve=${curve} places=${motions[k].places_mm} />
    <div class="orders"><button class="go" onClick=${() => { if (step.value >= motions.length - 1) step.value = 0; plays.value = !plays.value; }}>${plays.value ? "Pause" : "Play"}</button>
      <label>Motion: ${words(motions[Math.round(step.value)].name)}, base ${number(mix(motions[k].base_deg, next.base_deg), 1)}°, torque ${number(mix(motions[k].torque_nmm, next.torque_nmm), 3)} N·mm
        <input type="range" min="0" max=${motions.length - 1} step="0.05" value=${step.value} onInput=${(/** @type {Event} */ e) => { plays.value = false; step.value = Number(written(e)); }} /></label></div>
    <p class="quiet">Settled states of the model without noise; between them the picture is interpolated.</p></section>`;
}
