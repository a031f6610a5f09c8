// Where a model fails: errors, the residual map, and the traces behind each of its cells.
import { Errors, Figures, More, Values, forgetFigures, held, holdAs } from "./compared.js";
import { asked, busy, found as known, ofSubject } from "./found.js";
import { alive, done, result } from "./jobs.js";
import { zoom } from "./plot.js";
import { refuse, subject } from "./store.js";
import { Loop, Traced, recorded } from "./traced.js";
import { computed, effect, html, number, signal, untracked, words } from "./ui.js";

/** @typedef {import("./types").CompareResult} Found */
/** @typedef {import("./types").PlaceError} Place */
/** The comparison of the present data and model. */
const comparison = computed(() => known.value.compare);
/** Shown trial, its shown stretch and the cell that was clicked. */
const trial = signal(0);
/** @type {{value: [number, number] | null}} */
const stretch = signal(null);
const cell = signal("");
/** The candidate that is laid over the traces. */
export const over = signal("");

effect(() => {
  // another comparison: nothing of what was looked at holds any more, and its worst trial comes first
  const asked = comparison.value?.asked ?? {};
  untracked(forgetFigures);
  holdAs(asked);
  over.value = cell.value = "";
  stretch.value = null;
  trial.value = 0;
});

/** What the form holds, without what it leaves as it is. */
const heldOnly = () => Object.fromEntries(Object.entries(held.value).filter(([, value]) => value === true || Object.keys(value).length));
/** Whether a figure is drawn now. */
const drawing = computed(() => ofSubject.value.some((job) => alive(job) && (job.kind === "figure" || job.kind === "compare")));

/** Compare with what the form holds. */
async function compareAgain() {
  const of = subject.value;
  if (of) await done({ kind: "compare", ...asked(of), ...heldOnly() });
}

/** Where one colour ends and the next begins, half a decade apart; the second is the limit. */
const LEVELS = [1, 3, 10, 30, 100, 300];
/** @param {number} sigmas */
const heat = (sigmas) => `h${LEVELS.filter((limit) => sigmas >= limit).length}`;
/** Phases beside each other, above which their numbers are small. */
const MOST_LARGE = 28;
const narrow = matchMedia("(max-width: 760px)");
/** On a narrow page the phases stand below each other, so that the map fits. */
const upright = signal(narrow.matches);
narrow.addEventListener("change", () => (upright.value = narrow.matches));
const ARROWS = /** @type {Record<string, string>} */ ({ up: " ↑", down: " ↓" });

/** Where the model fails. */
export function Compared() {
  const found = comparison.value;
  if (!found) return null;
  return html`<section class="card wide"><h2>2 · Where it fails</h2>
      <p><strong>${found.name}</strong> ${found.sentence}</p>
      <${Errors} found=${found} />
      <${ResidualMap} found=${found} />
      <${Values} found=${found} />
      <${More} found=${found} own=${subject.value?.model != null} busy=${busy.value} again=${compareAgain} />
      ${found.traces && found.sentences.length ? html`<details><summary>The worst places in words</summary><ul>${found.sentences.map((/** @type {string} */ s) => html`<li>${s}</li>`)}</ul></details>` : null}
      ${found.notes?.length ? html`<details><summary>${found.notes.length} ${found.notes.length === 1 ? "note" : "notes"} on the data</summary><ul>${found.notes.map((/** @type {string} */ s) => html`<li>${s}</li>`)}</ul></details>` : null}
    </section>
    ${found.traces ? html`<${Traces} found=${found.traces} /><${Figures} busy=${drawing.value} draw=${draw} refuse=${refuse} />` : null}`;
}

/** @param {string} what */
async function draw(what) {
  const of = subject.value;
  const job = of && comparison.value && (await done({ kind: "figure", compared: comparison.value.key, what, ...asked(of) }));
  return job ? await result(job.key).catch(refuse) : null;
}

/** @param {{found: Found}} props */
function ResidualMap({ found }) {
  const channels = [...new Set(found.places.map((p) => p.channel))];
  /** @type {Map<string, Place>} */
  const columns = new Map(found.places.map((p) => [`${p.motion}|${p.direction ?? ""}|${p.state}`, p]));
  /** @type {Map<string, Place>} */
  const at = new Map(found.places.map((p) => [`${p.channel}|${p.motion}|${p.direction ?? ""}|${p.state}`, p]));
  /** @param {Place} place @param {string} key */
  const go = (place, key) => {
    cell.value = key;
    if (!found.traces) return;
    const index = found.traces.trials.findIndex((t) => t.file === place.trial);
    const k = index >= 0 ? index : found.traces.trials.findIndex((t) => t.motions.some((m) => m.name === place.motion));
    if (k < 0) return;
    trial.value = k;
    zoom("traces", null);
    const motion = found.traces.trials[k].motions.find((m) => m.name === place.motion);
    stretch.value = motion ? [Math.max(0, motion.start_s - 0.5), motion.end_s + 0.5] : null;
    document.getElementById(`trace-${place.channel}`)?.scrollIntoView({ block: "center" });
  };
  /** @param {string} channel @param {string} column */
  const cellOf = (channel, column) => {
    const key = `${channel}|${column}`;
    const place = at.get(key);
    if (!place || place.sigmas === null || place.sigmas === undefined) return html`<td></td>`;
    const text = place.words || `${words(place.channel)}, ${words(place.motion)} ${place.state}: ${number(place.sigmas, 1)} times the noise`;
    return html`<td><button class=${heat(place.sigmas)} title=${text} aria-label=${text} aria-pressed=${cell.value === key}
      onClick=${() => go(place, key)}>${place.sigmas >= 9.95 ? Math.round(place.sigmas) : number(place.sigmas, 1)}</button></td>`;
  };
  const phases = [...columns].map(([column, p]) => ({ column, name: `${words(p.motion)}${ARROWS[p.direction ?? ""] ?? ""} ${p.state}` }));
  return html`<p class="quiet map-words">Error in units of the noise, channel by phase.${found.traces ? " Click a cell to see the place in the traces." : ""}</p>
    <p class="levels" aria-label="Colours of the map, on a logarithmic scale; 3 is the limit">${[0, ...LEVELS].map((level, k) => html`<span class=${`h${k}`}>${k ? html`<b class=${level === 3 ? "limit" : ""}>${level}</b>` : null}</span>`)}<span class="quiet">× noise; 3 is the limit</span></p>
    <div class="scroll" tabindex="0" role="group" aria-label="Residual map">${upright.value
      ? html`<table class="map upright"><thead><tr><td></td>${channels.map((channel) => html`<th scope="col"><span>${words(String(channel))}</span></th>`)}</tr></thead>
        <tbody>${phases.map(({ column, name }) => html`<tr><th scope="row">${name}</th>${channels.map((channel) => cellOf(String(channel), column))}</tr>`)}</tbody></table>`
      : html`<table class=${phases.length > MOST_LARGE ? "map dense" : "map"}><thead><tr><td></td>${phases.map(({ name }) => html`<th scope="col"><span>${name}</span></th>`)}</tr></thead>
        <tbody>${channels.map((channel) => html`<tr><th scope="row">${words(String(channel))}</th>${phases.map(({ column }) => cellOf(String(channel), column))}</tr>`)}</tbody></table>`}</div>`;
}

/** @param {{found: import("./types").DrawnTraces}} props */
function Traces({ found }) {
  const { channels, trials, of } = found;
  const k = Math.min(trial.value, trials.length - 1);
  const shown = trials[k];
  const part = recorded(shown);
  const candidate = over.value ? known.value.diagnose?.candidates?.[over.value]?.[shown.file] : null;
  return html`<section class="card wide"><h2>Traces</h2>
    <div class="tabs" role="group" aria-label="Trials">${trials.map((t, i) => html`<button aria-pressed=${i === k}
      onClick=${() => { trial.value = i; stretch.value = null; zoom("traces", null); }}>${i + 1} · ${t.title}</button>`)}
      ${stretch.value ? html`<button onClick=${() => (stretch.value = null)}>Whole trial</button>` : null}</div>
    ${trials.length < of ? html`<p class="quiet">${trials.length} of ${of} trials are drawn.</p>` : null}
    ${over.value ? html`<p>Laid over: what <strong>${words(over.value)}</strong> predicts, fitted.</p>` : null}
    <${Traced} channels=${channels} trial=${part} stretch=${stretch.value} over=${candidate ? { name: over.value, values: candidate.map((values) => values.slice(-part.time_s.length)) } : null} group="traces" />
    <h3>Torque against angle</h3><${Loop} trial=${part} name=${shown.file} /></section>`;
}
