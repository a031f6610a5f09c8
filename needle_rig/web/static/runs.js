// What was recorded: list, filter, tags and notes, two side by side, export, and a way to the workbench.
import { ask, compute, save } from "./net.js";
import { Plot, line } from "./plot.js";
import { html, number, signal, useEffect, words } from "./ui.js";
import { chosen, compareChosen, models } from "./workbench.js";

/** @type {{value: any[] | null}} */
const runs = signal(null);
const filter = signal("");
/** Names of marked runs, in the order of marking. @type {{value: string[]}} */
const marked = signal([]);
/** @type {{value: any}} */
const shown = signal(null);
const refused = signal("");
const busy = signal("");

const reload = () => ask("GET", "runs").then((found) => (runs.value = found.runs), (error) => (refused.value = error.message));

/** @param {any} request */
async function work(request) {
  refused.value = "";
  try {
    return await compute(request, (now) => (busy.value = now.step));
  } catch (error) {
    refused.value = /** @type {Error} */ (error).message;
    return null;
  } finally {
    busy.value = "";
  }
}

/** @param {any} run @param {string} form */
async function exported(run, form) {
  const made = await work({ kind: "export", data: [`run:${run.name}`], form });
  if (made) await save(`jobs/${made.key}/${encodeURIComponent(made.file)}`, made.file).catch((error) => (refused.value = error.message));
}

async function side() {
  shown.value = await work({ kind: "show", data: marked.value.slice(-2).map((name) => `run:${name}`) });
}

/** @param {any} run @param {string[]} tags @param {string} note */
async function keep(run, tags, note) {
  refused.value = "";
  try {
    await ask("PUT", `runs/${encodeURIComponent(run.name)}/notes`, { tags, note });
    await reload();
  } catch (error) {
    refused.value = /** @type {Error} */ (error).message;
  }
}

function diagnose() {
  chosen.value = marked.value.map((name) => `run:${name}`);
  models.value = [];
  location.hash = "#/workbench";
  compareChosen();
}

export function Runs() {
  useEffect(() => { reload(); }, []);
  const listed = (runs.value ?? []).filter((run) => {
    const text = [run.name, run.status, run.strategy, run.parameters, run.note, ...run.tags].join(" ").toLowerCase();
    return filter.value.toLowerCase().split(/\s+/).every((word) => text.includes(word));
  });
  /** @param {string} name */
  const toggle = (name) => (marked.value = marked.value.includes(name) ? marked.value.filter((n) => n !== name) : [...marked.value, name]);
  return html`<h1>Runs</h1>
    ${refused.value ? html`<p class="refusal" role="alert">${refused.value}</p>` : null}
    <section class="card"><div class="orders">
      <label>Filter <input type="search" value=${filter.value} placeholder="name, status, strategy, tag" onInput=${(/** @type {any} */ e) => (filter.value = e.target.value)} /></label>
      <button disabled=${marked.value.length !== 2 || busy.value !== ""} onClick=${side}>Side by side</button>
      <button class="go" disabled=${!marked.value.length} onClick=${diagnose}>Diagnose these (${marked.value.length})</button>
      <span class="quiet" role="status">${busy.value}</span></div>
    ${runs.value && !listed.length ? html`<p class="quiet">${runs.value.length ? "No run fits the filter." : "Nothing is recorded yet: compensate on the page Live."}</p>` : null}
    <div class="scroll" tabindex="0" role="group" aria-label="Recorded runs"><table><thead><tr><th>run</th><th class="text">started (UTC)</th><th>target / °</th><th class="text">strategy</th><th class="text">status</th><th>duration / s</th><th class="text">tags</th><th class="text">note</th><th class="text">export</th></tr></thead>
      <tbody>${listed.map((run) => html`<tr key=${run.name}><th scope="row"><label class="row"><input type="checkbox" checked=${marked.value.includes(run.name)} onChange=${() => toggle(run.name)} /> ${run.name}</label></th>
        <td class="text">${run.started_utc.slice(0, 19).replace("T", " ")}</td><td>${number(run.target_deg, 1)}</td><td class="text">${words(run.strategy)}${run.simulated ? html` <span class="tag">simulated</span>` : null}</td>
        <td class="text">${words(run.status)}</td><td>${number(run.duration_s, 1)}</td>
        <td><input aria-label=${`Tags of ${run.name}`} value=${run.tags.join(", ")} placeholder="a, b"
          onChange=${(/** @type {any} */ e) => keep(run, e.target.value.split(",").map((/** @type {string} */ t) => t.trim()).filter(Boolean), run.note)} /></td>
        <td><input aria-label=${`Note on ${run.name}`} value=${run.note} onChange=${(/** @type {any} */ e) => keep(run, run.tags, e.target.value)} /></td>
        <td><select aria-label=${`Export ${run.name}`} value="" onChange=${(/** @type {any} */ e) => { exported(run, e.target.value); e.target.value = ""; }}>
          <option value="">…</option><option value="csv">CSV</option><option value="mcap">MCAP</option><option value="png">picture</option><option value="dataset">dataset</option></select></td></tr>`)}</tbody></table></div></section>
    ${shown.value ? html`<div class="grid2">${shown.value.runs.map((/** @type {any} */ run) => html`<section class="card"><h2>${run.run}</h2>
      <p class="quiet">${run.title}${run.result ? ` · ${words(run.result.status)}` : ""}</p>
      <${Plot} label=${`Angles of ${run.run}`} unit="angle / °" height=${240} marks=${run.motions} cursor="runs"
        series=${[line("base", "--base"), ...run.sensors.map((/** @type {string} */ s, /** @type {number} */ k) => line(words(s), `--c${k + 1}`))]} data=${[run.time_s, run.base_deg, ...run.measured.slice(1)]} />
      <${Plot} label=${`Torque of ${run.run}`} unit="torque / N·mm" height=${180} marks=${run.motions} cursor="runs"
        series=${[line("torque", "--c0")]} data=${[run.time_s, run.measured[0]]} /></section>`)}</div>` : null}`;
}
