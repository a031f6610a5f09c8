// What was recorded: the list, each run's own page with tags, a note and export, two side by side, and a way to the workbench.
import { begin, done, jobs, result, Working } from "./jobs.js";
import { ask, save } from "./net.js";
import { Plot, line } from "./plot.js";
import { dataRoute, place, refuse, route, run, said } from "./store.js";
import { computed, effect, html, number, signal, untracked, useEffect, words } from "./ui.js";

/** What the server listed: runs, how many fit, how many were not read yet. @type {{value: any}} */
const listed = signal(null);
const filter = signal("");
const order = signal({ by: "started_utc", down: true });
const start = signal(0);
const SHOWN = 100;
const INDEXING_MS = 1000;
/** Names of marked runs, in the order of marking. @type {{value: string[]}} */
const marked = signal([]);
/** Traces of one run or of several. @type {{value: {id: string, runs: any[]}}} */
const traces = signal({ id: "", runs: [] });
/** What is written and not kept yet, by run. @type {{value: Record<string, {tags?: string, note?: string}>}} */
const drafts = signal({});
let asked = 0;

const NOTE_LETTERS = 4000;

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
/** One run as the list has it. @type {{value: any}} */
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
  if (shown.value.length) return html`<h1>Runs side by side</h1><p><a href="#/runs">All runs</a></p><${Working} kinds=${["show"]} of=${jobs.value} /><${Traces} names=${shown.value} />`;
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
  return html`<h1>Runs</h1>
    <section class="card"><div class="orders">
      <label>Filter <input type="search" value=${filter.value} placeholder="name, status, strategy, tag" onInput=${(/** @type {any} */ e) => { filter.value = e.target.value; start.value = 0; list(); }} /></label>
      <button aria-disabled=${marked.value.length !== 2} onClick=${() => marked.value.length === 2 && (location.hash = route("runs", "", marked.value.map((name) => ["run", name])))}>Side by side</button>
      <button class="go" aria-disabled=${!marked.value.length} onClick=${() => marked.value.length && (location.hash = dataRoute(marked.value.map(run)))}>Diagnose these (${marked.value.length})</button>
      ${now?.indexing ? html`<span class="quiet" role="status">Reading ${now.indexing} more …</span>` : null}</div>
    ${now ? null : html`<p class="quiet" role="status">Loading …</p>`}
    ${now && !now.runs.length ? html`<p class="quiet">${filter.value ? "No run fits the filter." : html`Nothing is recorded yet. Compensate on the page <a href="#/live">Live</a>: each run is kept here.`}</p>` : null}
    ${now?.runs.length ? html`<div class="scroll" tabindex="0" role="group" aria-label="Recorded runs"><table class="runs"><thead><tr><th><span class="hidden">marked</span></th>${COLUMNS.map(([by, label, side]) => html`<th scope="col" class=${side}
        aria-sort=${order.value.by === by ? (order.value.down ? "descending" : "ascending") : undefined}><button class="sort" onClick=${() => sort(by)}>${label}${order.value.by === by ? (order.value.down ? " ↓" : " ↑") : ""}</button></th>`)}</tr></thead>
      <tbody>${now.runs.map((/** @type {any} */ each) => html`<tr key=${each.name}><td><input type="checkbox" aria-label=${`Mark ${each.name}`} checked=${marked.value.includes(each.name)} onChange=${() => toggle(each.name)} /></td>
        <th scope="row"><a href=${route("runs", each.name)}>${each.name}</a>${each.simulated ? html` <span class="tag">simulated</span>` : null}</th>
        <td class="text">${local(each.started_utc)}</td><td>${number(each.target_deg, 1)}</td><td class="text">${words(each.strategy)}</td>
        <td class="text">${words(each.status)}</td><td>${number(each.duration_s, 1)}</td><td class="text">${each.tags.join(", ")}</td><td class="text note" title=${each.note}>${each.note}</td></tr>`)}</tbody></table></div>
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
  return html`<h1>${name}</h1>
    <section class="card"><p>${local(now.started_utc)} · ${now.target_deg === null ? "no target" : `to ${number(now.target_deg, 1)}°`} with ${words(now.strategy) || "no strategy"} · <strong>${words(now.status)}</strong> · ${number(now.duration_s, 1)} s${now.simulated ? html` <span class="tag">simulated</span>` : null}</p>
      <p class="buttons"><a class="button go" href=${dataRoute([run(name)])}>Diagnose this run</a>
        ${["csv", "mcap", "png", "dataset"].map((form) => html`<button onClick=${() => exported(name, form)}>${{ csv: "CSV", mcap: "MCAP", png: "Picture", dataset: "Dataset" }[form]}</button>`)}
        <a href="#/runs">All runs</a></p>
      <${Working} kinds=${["export", "show"]} of=${jobs.value.filter((job) => job.data.some((/** @type {any} */ d) => d.name === name))} />
      <div class="notes"><label>Tags, with commas between <input aria-label=${`Tags of ${name}`} value=${draft.tags ?? now.tags.join(", ")} onInput=${(/** @type {any} */ e) => write(name, "tags", e.target.value)} onChange=${(/** @type {any} */ e) => keep(name, "tags", e.target.value)} /></label>
        <label>Note <textarea aria-label=${`Note on ${name}`} rows="3" maxlength=${NOTE_LETTERS} value=${draft.note ?? now.note} onInput=${(/** @type {any} */ e) => write(name, "note", e.target.value)} onChange=${(/** @type {any} */ e) => keep(name, "note", e.target.value)}></textarea></label></div></section>
    <${Traces} names=${[name]} />`;
}

/** @param {{names: string[]}} props */
function Traces({ names }) {
  if (traces.value.id !== JSON.stringify(names)) return null;
  return html`<div class="grid2">${traces.value.runs.map((/** @type {any} */ each) => html`<section class=${names.length === 1 ? "card wide" : "card"}>${names.length === 1 ? null : html`<h2><a href=${route("runs", each.run)}>${each.run}</a></h2>`}
      <p class="quiet">${each.title}${each.result ? ` · ${words(each.result.status)}` : ""}</p>
      <${Plot} label=${`Angles of ${each.run}`} unit="angle / °" height=${240} marks=${each.motions} cursor="runs"
        series=${[line("base", "--base"), ...each.sensors.map((/** @type {string} */ s, /** @type {number} */ k) => line(words(s), `--c${k + 1}`))]} data=${[each.time_s, each.base_deg, ...each.measured.slice(1)]} />
      <${Plot} label=${`Torque of ${each.run}`} unit="torque / N·mm" height=${180} marks=${each.motions} cursor="runs"
        series=${[line("torque", "--c0")]} data=${[each.time_s, each.measured[0]]} /></section>`)}</div>`;
}
