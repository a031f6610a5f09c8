// What was recorded: the list, each run's own page with tags, a note and export, two side by side, and a way to the workbench.
import { Figures, forgetFigures } from "./compared.js";
import { Working, alive, done, jobs, result } from "./jobs.js";
import { ask, save } from "./net.js";
import { Legend, Plot, line, zoom } from "./plot.js";
import { about, dataRoute, place, refuse, route, run, said } from "./store.js";
import { Loop, Traced, recorded } from "./traced.js";
import { Cells, Heads, computed, effect, html, number, signal, untracked, useEffect, useSignal, words, written } from "./ui.js";

/** What the server listed: runs, how many fit, how many were not read yet. @type {{value: import("./types").RunsDocument | null}} */
const listed = signal(null);
const filter = signal("");
const order = signal({ by: "started_utc", down: true });
const start = signal(0);
const SHOWN = 100;
const INDEXING_MS = 1000;
/** Names of marked runs, in the order of marking. @type {{value: string[]}} */
const marked = signal([]);
/** Traces of one run or of several. @type {{value: {id: string, runs: Shown[]}}} */
const traces = signal({ id: "", runs: [] });
/** What is written and not kept yet, by run. @type {{value: Record<string, {tags?: string, note?: string}>}} */
const drafts = signal({});
let asked = 0;

const NOTE_LETTERS = 4000;
/** The choice of the null model, which has no key. */
const NULL = "null model";

async function list() {
  const mine = (asked += 1);
  const query = new URLSearchParams({ filter: filter.value, by: order.value.by, down: order.value.down ? "1" : "0", start: String(start.value) });
  try {
    const found = await ask("GET", `runs?${query}`);
    if (mine !== asked) return;
    listed.value = found;
    if (found.indexing) setTimeout(() => mine === asked && place.value.view === "runs" && list(), INDEXING_MS);
  } catch (error) {
    refuse(error);
  }
}

/** The runs of the address. */
const shown = computed(() => (place.value.view !== "runs" ? [] : place.value.name ? [place.value.name] : place.value.query.getAll("run")));
/** One run as the list has it. @type {{value: import("./types").RunDocument | null}} */
const one = signal(null);
const lost = signal("");

/** @param {string[]} names */
async function show(names) {
  const id = JSON.stringify(names);
  const request = { kind: "show", data: names.map((name) => `run:${name}`) };
  lost.value = "";
  try {
    if (names.length === 1) one.value = await ask("GET", `runs/${encodeURIComponent(names[0])}`);
  } catch (error) {
    lost.value = /** @type {Error} */ (error).message;
    return;
  }
  const job = await done(request);
  if (!job) return;
  const found = await result(job.key).catch(refuse);
  if (found && JSON.stringify(shown.value) === id) traces.value = { id, runs: found.runs };
}
effect(() => {
  const names = shown.value;
  if (names.length) untracked(() => show(names));
});

/** @param {string} name @param {string} form */
async function exported(name, form) {
  const job = await done({ kind: "export", data: [`run:${name}`], form });
  const made = job && (await result(job.key).catch(refuse));
  if (made) await save(`jobs/${job.key}/${encodeURIComponent(made.file)}`, made.file).catch(refuse);
}

/** What is written stays while the view is drawn anew. @param {string} name @param {"tags" | "note"} field @param {string} text */
const write = (name, field, text) => (drafts.value = { ...drafts.value, [name]: { ...drafts.value[name], [field]: text } });

/** Keep what changed of a run; a refused draft stays where it was written. @param {string} name @param {"tags" | "note"} field @param {string} text */
async function keep(name, field, text) {
  said.value = "";
  const content = field === "note" ? text : text.split(",").map((tag) => tag.trim()).filter(Boolean);
  try {
    const kept = await ask("PUT", `runs/${encodeURIComponent(name)}/notes`, { [field]: content });
    const { [field]: _, ...others } = drafts.value[name] ?? {};
    drafts.value = { ...drafts.value, [name]: others };
    if (one.value?.name === name) one.value = { ...one.value, ...kept };
  } catch (error) {
    refuse(error);
  }
}

/** @param {string} utc */
const local = (utc) => (utc ? new Date(utc.endsWith("Z") || /[+-]\d\d:\d\d$/.test(utc) ? utc : `${utc}Z`).toLocaleString(undefined, { dateStyle: "short", timeStyle: "medium" }) : "–");

export function Runs() {
  if (place.value.name) return html`<${One} name=${place.value.name} />`;
  if (shown.value.length) return html`<h1>Runs side by side</h1><p><a href="#/runs">All runs</a></p><${Working} kinds=${["show"]} of=${jobs.value} /><${Beside} names=${shown.value} />`;
  return html`<${List} />`;
}

/** @type {[string, string, string][]} */
const COLUMNS = [["name", "run", ""], ["started_utc", "started", "text"], ["target_deg", "target / °", ""], ["strategy", "strategy", "text"], ["status", "status", "text"], ["duration_s", "duration / s", ""], ["tags", "tags", "text"], ["note", "note", "text"]];

function List() {
  useEffect(() => { list(); }, []);
  const now = listed.value;
  const sort = (/** @type {string} */ by) => {
    order.value = { by, down: order.value.by === by ? !order.value.down : by === "started_utc" || by === "duration_s" };
    start.value = 0;
    list();
  };
  /** @param {string} name */
  const toggle = (name) => (marked.value = marked.value.includes(name) ? marked.value.filter((n) => n !== name) : [...marked.value, name]);
  const go = (/** @type {number} */ to) => { start.value = to; list(); };
  return html`<h1>Runs</h1><p class="purpose">Look at what was recorded, hold a model against it, and choose runs to learn from.</p>
    <section class="card"><div class="orders">
      <label>Filter <input type="search" class="long" value=${filter.value} placeholder="name, status, strategy, tag" onInput=${(/** @type {Event} */ e) => { filter.value = written(e); start.value = 0; list(); }} /></label>
      <button aria-disabled=${marked.value.length !== 2} onClick=${() => marked.value.length === 2 && (location.hash = route("runs", "", marked.value.map((name) => ["run", name])))}>Side by side</button>
      <button class="go" aria-disabled=${!marked.value.length} onClick=${() => marked.value.length && (location.hash = dataRoute(marked.value.map(run)))}>Diagnose these (${marked.value.length})</button>
      ${now?.indexing ? html`<span class="quiet" role="status">Reading ${now.indexing} more …</span>` : null}</div>
    ${now ? null : html`<p class="quiet" role="status">Loading …</p>`}
    ${now && !now.runs.length ? html`<p class="quiet">${filter.value ? "No run fits the filter." : html`Nothing is recorded yet. Compensate on the page <a href="#/live">Live</a>: each run is kept here.`}</p>` : null}
    ${now?.runs.length ? html`<div class="scroll" tabindex="0" role="group" aria-label="Recorded runs"><table class="runs stacked rows"><thead><tr><th><span class="hidden">marked</span></th>${COLUMNS.map(([by, label, side]) => html`<th scope="col" class=${side}
        aria-sort=${order.value.by === by ? (order.value.down ? "descending" : "ascending") : undefined}><button class="sort" onClick=${() => sort(by)}>${label}${order.value.by === by ? (order.value.down ? " ↓" : " ↑") : ""}</button></th>`)}</tr></thead>
      <tbody>${now.runs.map((each) => html`<tr key=${each.name}><td><input type="checkbox" aria-label=${`Mark ${each.name}`} checked=${marked.value.includes(each.name)} onChange=${() => toggle(each.name)} /></td>
        <th scope="row"><a href=${route("runs", each.name)}>${each.name}</a>${each.simulated ? html` <span class="tag">simulated</span>` : null}</th>
        <td class="text">${local(each.started_utc)}</td><td data-label="target / °">${number(each.target_deg, 1)}</td><td class="text" data-label="strategy">${words(each.strategy)}</td>
        <td class="text" data-label="status">${words(each.status)}</td><td data-label="duration / s">${number(each.duration_s, 1)}</td><td class="text">${each.tags.join(", ")}</td><td class="text note" title=${each.note}>${each.note}</td></tr>`)}</tbody></table></div>
      ${now.of > SHOWN ? html`<p class="buttons"><button aria-disabled=${!start.value} onClick=${() => start.value && go(Math.max(0, start.value - SHOWN))}>Before</button>
        <span class="quiet">${start.value + 1} to ${start.value + now.runs.length} of ${now.of}</span>
        <button aria-disabled=${start.value + SHOWN >= now.of} onClick=${() => start.value + SHOWN < now.of && go(start.value + SHOWN)}>Next</button></p>` : null}` : null}</section>`;
}

/** A run's own page. @param {{name: string}} props */
function One({ name }) {
  const now = one.value?.name === name ? one.value : null;
  if (lost.value) return html`<h1>${name}</h1><p class="refusal" role="alert">${lost.value} <a href="#/runs">All runs</a></p>`;
  if (!now) return html`<h1>${name}</h1><p class="quiet" role="status">Loading …</p>`;
  const draft = drafts.value[name] ?? {};
  const of = jobs.value.filter((job) => job.data.some((/** @type {import("./store.js").Named} */ d) => d.name === name));
  return html`<h1>${name}</h1>
    <section class="card"><p>${local(now.started_utc)} · ${now.target_deg === null ? "no target" : `to ${number(now.target_deg, 1)}°`} with ${words(now.strategy) || "no strategy"} · <strong>${words(now.status)}</strong> · ${number(now.duration_s, 1)} s${now.simulated ? html` <span class="tag">simulated</span>` : null}</p>
      <p class="buttons"><a class="button go" href=${dataRoute([run(name)])}>Diagnose this run</a>
        ${["csv", "mcap", "png", "dataset"].map((form) => html`<button onClick=${() => exported(name, form)}>${{ csv: "CSV", mcap: "MCAP", png: "Picture", dataset: "Dataset" }[form]}</button>`)}
        <${Removing} name=${name} /> <a href="#/runs">All runs</a></p>
      <${Working} kinds=${["export", "show"]} of=${of} />
      <div class="notes"><label>Tags, with commas between <input aria-label=${`Tags of ${name}`} value=${draft.tags ?? now.tags.join(", ")} onInput=${(/** @type {InputEvent} */ e) => write(name, "tags", written(e))} onChange=${(/** @type {InputEvent} */ e) => keep(name, "tags", written(e))} /></label>
        <label>Note <textarea aria-label=${`Note on ${name}`} rows="3" maxlength=${NOTE_LETTERS} value=${draft.note ?? now.note} onInput=${(/** @type {InputEvent} */ e) => write(name, "note", written(e))} onChange=${(/** @type {InputEvent} */ e) => keep(name, "note", written(e))}></textarea></label></div></section>
    <${Told} name=${name} />`;
}

/** Remove a run, after a second word. @param {{name: string}} props */
function Removing({ name }) {
  const sure = useSignal(false);
  const remove = async () => {
    try {
      await ask("DELETE", `runs/${encodeURIComponent(name)}`);
      marked.value = marked.value.filter((other) => other !== name);
      location.hash = route("runs");
    } catch (error) {
      sure.value = false;
      refuse(error);
    }
  };
  return sure.value ? html`<span class="buttons" role="group" aria-label="Delete this run"><strong>Delete this run with its notes, for good?</strong> <button class="danger" onClick=${remove}>Delete</button> <button onClick=${() => (sure.value = false)}>Keep</button></span>`
    : html`<button onClick=${() => (sure.value = true)}>Delete …</button>`;
}

/** What a model was held against this run. @type {{value: {of: string, found: Compared | null}}} */
const compared = signal({ of: "", found: null });
/** @typedef {{key: string, name: string, sentence: string, traces: {channels: import("./traced.js").Channel[], trials: import("./traced.js").Trial[]} | null}} Compared */

/** Hold a model against the run; `null` is the null model, fitted. @param {string} name @param {string | null} model */
async function hold(name, model) {
  const of = `${name} ${model}`;
  compared.value = { of, found: null };
  forgetFigures();
  const job = await done({ kind: "compare", data: [`run:${name}`], model });
  const found = job && (await result(job.key).catch(refuse));
  if (found && compared.value.of === of) compared.value = { of, found };
}

/** @typedef {{run: string, title: string, sensors: string[], settings: Record<string, string>, events: {time_s: number | null, kind: string, text: string}[],
 *   result: {status: string, motions: {phase: string, base_deg: number | null, torque_nmm: number | null, hall_deg: (number | null)[]}[]} | null} & import("./traced.js").Trial} Shown */

/** What a run holds: its traces, beside a model where one is chosen, settings and events. @param {{name: string}} props */
function Told({ name }) {
  const choice = useSignal("");
  const piece = useSignal(0);
  if (traces.value.id !== JSON.stringify([name])) return null;
  /** @type {Shown} */
  const shown = traces.value.runs[0];
  const settled = ["base / °", "torque / N·mm", ...shown.sensors.map((sensor) => `${words(sensor)} / °`)];
  const models = about.value?.models ?? [];
  const key = choice.value === NULL ? null : choice.value;
  const held = choice.value && compared.value.of === `${name} ${key}` ? compared.value.found : null;
  const working = jobs.value.filter((job) => job.data.some((/** @type {import("./store.js").Named} */ d) => d.name === name) && !["show", "export"].includes(job.kind));
  const pieces = held?.traces?.trials ?? [shown];
  const part = Math.min(piece.value, pieces.length - 1);
  const trial = recorded(pieces[part]);
  /** @type {import("./traced.js").Channel[]} */
  const channels = held?.traces?.channels ?? [{ name: "torque", unit: "N·mm", noise: 0 }, ...shown.sensors.map((sensor) => ({ name: sensor, unit: "°", noise: 0 }))];
  const draw = async (/** @type {string} */ what) => {
    const job = held && (await done({ kind: "figure", compared: held.key, what, data: [`run:${name}`], model: key }));
    return job ? result(job.key).catch(refuse) : null;
  };
  return html`<section class="card"><h2>Traces</h2>
      <p><label>Hold a model against this run <select value=${choice.value} onChange=${(/** @type {Event} */ e) => { choice.value = written(e); piece.value = 0; zoom("run", null); if (choice.value) hold(name, choice.value === NULL ? null : choice.value); }}>
        <option value="">none: what was measured</option><option value=${NULL}>rigid tissue and uniform friction, both fitted</option>
        ${models.map((/** @type {import("./store.js").Named} */ m) => html`<option value=${m.key}>${words(m.name)}</option>`)}</select></label></p>
      <${Working} kinds=${["compare", "figure"]} of=${working} />
      ${held ? html`<p><strong>${held.name}</strong> ${held.sentence}</p>` : null}
      ${pieces.length > 1 ? html`<div class="tabs" role="group" aria-label="Parts of the run that are predicted">${pieces.map((each, k) => html`<button aria-pressed=${k === part} onClick=${() => { piece.value = k; zoom("run", null); }}>${k + 1} · ${words(each.motions.at(-1)?.name ?? each.title)}</button>`)}</div>` : null}
      <h3>base</h3><${Plot} name=${`${name}-base`} label="Angle of the base" unit="base / °" height=${130} cursor="run" marks=${trial.motions} series=${[line("base", "--base")]} data=${[trial.time_s, trial.base_deg]} />
      <${Traced} channels=${channels} trial=${trial} group="run" name=${name} />
      <h3>Torque against angle</h3><${Loop} trial=${trial} name=${name} /></section>
    ${held ? html`<${Figures} busy=${working.some(alive)} draw=${draw} refuse=${refuse} />` : null}
    <div class="grid2"><section class="card"><h2>Settings</h2><dl class="settings">${Object.entries(shown.settings).map(([word, value]) => html`<div><dt>${word}</dt><dd>${words(value)}</dd></div>`)}</dl>
        ${shown.result?.motions.length ? html`<h3>Motions</h3><div class="scroll" tabindex="0" role="group" aria-label="Motions of the run"><table class="stacked numbers"><${Heads} of="motion" names=${settled} />
          <tbody>${shown.result.motions.map((motion) => html`<tr><th scope="row">${words(motion.phase)}</th><${Cells} names=${settled} values=${[number(motion.base_deg, 2), number(motion.torque_nmm, 4), ...motion.hall_deg.map((angle) => number(angle, 1))]} /></tr>`)}</tbody></table></div>` : null}</section>
      <section class="card"><h2>Events</h2>${shown.events.length ? html`<div class="scroll events" tabindex="0" role="group" aria-label="Events of the run"><table><thead><tr><th scope="col">time / s</th><th scope="col" class="text">event</th></tr></thead>
        <tbody>${shown.events.map((event) => html`<tr class=${event.kind}><td>${number(event.time_s, 2)}</td><td class="text">${event.kind === "phase" ? "" : `${event.kind}: `}${words(event.text).replace(/^(\w+) \1,/, "$1,")}</td></tr>`)}</tbody></table></div>` : html`<p class="quiet">None were recorded.</p>`}</section></div>`;
}

/** @param {{names: string[]}} props */
function Beside({ names }) {
  if (traces.value.id !== JSON.stringify(names)) return null;
  /** @type {Shown[]} */
  const runs = traces.value.runs;
  const series = [line("base", "--base"), ...runs[0].sensors.map((sensor, k) => line(words(sensor), `--c${k + 1}`)), line("torque", "--c0")];
  return html`<${Legend} series=${series} /><div class="grid2">${runs.map((each) => html`<section class="card"><h2><a href=${route("runs", each.run)}>${each.run}</a></h2>
      <p class="quiet">${each.title}${each.result ? ` · ${words(each.result.status)}` : ""}</p>
      <${Plot} name=${`${each.run}-angles`} label=${`Angles of ${each.run}`} unit="angle / °" height=${240} marks=${each.motions} cursor="runs"
        series=${[line("base", "--base"), ...each.sensors.map((sensor, k) => line(words(sensor), `--c${k + 1}`))]} data=${[each.time_s, each.base_deg, ...each.measured.slice(1)]} />
      <${Plot} name=${`${each.run}-torque`} label=${`Torque of ${each.run}`} unit="torque / N·mm" height=${180} marks=${each.motions} cursor="runs"
        series=${[line("torque", "--c0")]} data=${[each.time_s, each.measured[0]]} /></section>`)}</div>`;
}
