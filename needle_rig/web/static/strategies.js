// The strategies on one's own model, and each planned sequence as a moving shaft.
import { ask, compute } from "./net.js";
import { ShaftPicture } from "./shaft.js";
import { html, number, signal, useEffect, words } from "./ui.js";
import { about, models } from "./workbench.js";

const targets = signal("45");
const seeds = signal("2");
const parameters = signal("rig_elastic");
/** @type {{value: any}} */
const job = signal(null);
/** @type {{value: any}} */
const found = signal(null);
const refused = signal("");
const name = signal("reed2008");
const step = signal(0);
const plays = signal(false);

async function run() {
  refused.value = "";
  const model = models.value.at(-1)?.key ?? null;
  const angles = targets.value.split(/[\s,;]+/).filter(Boolean).map(Number);
  try {
    found.value = await compute(
      { kind: "strategies", model, parameters: parameters.value, targets_deg: angles, seeds: Number(seeds.value) },
      (now) => (job.value = now),
    );
    step.value = 0;
    plays.value = false;
    if (!found.value.sequences[name.value]) name.value = Object.keys(found.value.sequences)[0] ?? "";
  } catch (error) {
    if (job.value?.state !== "cancelled") refused.value = /** @type {Error} */ (error).message;
  } finally {
    job.value = null;
  }
}

export function Strategies() {
  useEffect(() => {
    if (!about.value) ask("GET", "about").then((got) => (about.value = got), (error) => (refused.value = error.message));
  }, []);
  const now = job.value;
  const learnt = models.value.at(-1);
  return html`<h1>Strategies</h1>
    ${refused.value ? html`<p class="refusal" role="alert">${refused.value}</p>` : null}
    <section class="card"><form class="orders" onSubmit=${(/** @type {Event} */ e) => { e.preventDefault(); run(); }}>
      ${learnt ? html`<p>On the workbench's model <strong>${learnt.model}</strong> (${learnt.added.map(words).join(", ")}).</p>`
        : html`<label>Needle <select value=${parameters.value} onChange=${(/** @type {any} */ e) => (parameters.value = e.target.value)}>${(about.value?.parameters ?? []).map((/** @type {string} */ p) => html`<option value=${p} selected=${p === parameters.value}>${words(p)}</option>`)}</select></label>`}
      <label>Targets / ° <input value=${targets.value} onInput=${(/** @type {any} */ e) => (targets.value = e.target.value)} /></label>
      <label>Runs of each kind <input type="number" min="1" max="10" value=${seeds.value} onInput=${(/** @type {any} */ e) => (seeds.value = e.target.value)} /></label>
      <button class="go" disabled=${Boolean(now)}>Run every strategy</button></form>
      ${now ? html`<div class="job" role="status"><strong>${now.step}</strong><progress aria-label=${now.step} max=${now.total || 1} value=${now.total ? now.done : undefined}></progress>
        <span class="quiet">${now.total ? `${now.done} of ${now.total}` : ""}</span><button onClick=${() => ask("DELETE", `jobs/${now.key}`)}>Cancel</button></div>` : null}
    </section>
    ${found.value ? html`<${Table} /><${Moving} />` : null}`;
}

function Table() {
  const rows = [...found.value.rows].sort((a, b) => (a.worst_deg?.median ?? Infinity) - (b.worst_deg?.median ?? Infinity));
  /** @param {any} e @param {number} d */
  const both = (e, d) => (e ? `${number(e.median, d)} (${number(e.q95, d)})` : "–");
  return html`<section class="card"><h2>Side by side</h2><p class="quiet">Medians, 95 % quantiles in brackets. Choose one to see its sequence.</p>
    <div class="scroll" tabindex="0" role="group" aria-label="Strategies"><table><thead><tr><th>strategy</th><th>worst error / °</th><th>tip lag / °</th><th>mean error / °</th><th>torque / N·mm</th><th>rotations</th><th>time / s</th></tr></thead>
      <tbody>${rows.map((row) => html`<tr class=${row.strategy === name.value ? "named" : ""}><th scope="row"><button aria-pressed=${row.strategy === name.value} disabled=${!found.value.sequences[row.strategy]}
          onClick=${() => { name.value = row.strategy; step.value = 0; }}>${words(row.strategy)}</button></th>
        ${row.refused && !row.worst_deg ? html`<td class="text" colspan="6">${row.refused}</td>` : html`<td>${both(row.worst_deg, 1)}</td><td>${both(row.tip_lag_deg, 1)}</td><td>${both(row.mean_deg, 1)}</td><td>${both(row.torque_nmm, 3)}</td><td>${number(row.rotations, 0)}</td><td>${number(row.time_s, 1)}</td>`}</tr>`)}</tbody></table></div></section>`;
}

function Moving() {
  const motions = found.value.sequences[name.value]?.motions;
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
  return html`<section class="card"><h2>${words(name.value)} to ${found.value.target_deg}°</h2>
    <${ShaftPicture} rig=${found.value} points=${[[0, curve[0]]]} target=${found.value.target_deg} curve=${curve} places=${motions[k].places_mm} />
    <div class="orders"><button class="go" onClick=${() => { if (step.value >= motions.length - 1) step.value = 0; plays.value = !plays.value; }}>${plays.value ? "Pause" : "Play"}</button>
      <label>Motion: ${words(motions[Math.round(step.value)].name)}, base ${number(mix(motions[k].base_deg, next.base_deg), 1)}°, torque ${number(mix(motions[k].torque_nmm, next.torque_nmm), 3)} N·mm
        <input type="range" min="0" max=${motions.length - 1} step="0.05" value=${step.value} onInput=${(/** @type {any} */ e) => { plays.value = false; step.value = Number(e.target.value); }} /></label></div>
    <p class="quiet">Settled states of the model without noise; between them the picture is interpolated.</p></section>`;
}
