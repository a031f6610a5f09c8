// The circle by clicks: data, where the model fails, what is missing, add it, the error falls.
import { ask, compute, save } from "./net.js";
import { Errors, Figures, More, Values, forgetFigures, held, holdAll } from "./compared.js";
import { LearntLaws } from "./law.js";
import { WhatIsWhat, asConfirmed, proposal, propose, shaft } from "./mapping.js";
import { Plot, dots, line } from "./plot.js";
import { html, measured, number, parameter, signal, significant, useEffect, words } from "./ui.js";

/** What can be chosen. @type {{value: any}} */
export const about = signal(null);
/** Keys of the chosen data. @type {{value: string[]}} */
export const chosen = signal([]);
/** What was dropped. @type {{value: {key: string, name: string, kind: string}[]}} */
const dropped = signal([]);
const refused = signal("");
/** The computation that runs. @type {{value: any}} */
const job = signal(null);
/** @type {{value: any}} */
const compared = signal(null);
/** @type {{value: any}} */
const diagnosed = signal(null);
/** The law that was learnt. @type {{value: any}} */
const learnt = signal(null);
/** Models in the order in which they were learnt: the last is the present one. @type {{value: any[]}} */
export const models = signal([]);
/** Shown trial, its shown stretch and the cell that was clicked. */
const trial = signal(0);
/** @type {{value: [number, number] | null}} */
const stretch = signal(null);
const cell = signal("");
/** The candidate that is laid over the traces. */
const over = signal("");

const everyRow = signal(false);
const SHOWN_ROWS = 6;

/** Models that were learnt on this page or dropped on it; each can be held against other data. @type {{value: any[]}} */
const made = signal([]);
/** Where models start: a parameter set or a learnt model; empty for the null model. */
const start = signal("");

const model = () => models.value.at(-1)?.key ?? (start.value || null);

/** @param {any} request @returns {Promise<any>} */
async function run(request) {
  refused.value = "";
  try {
    return await compute(request, (now) => (job.value = now));
  } catch (error) {
    if (job.value?.state !== "cancelled") refused.value = /** @type {Error} */ (error).message;
    return null;
  } finally {
    job.value = null;
  }
}

async function compareAgain() {
  diagnosed.value = learnt.value = null;
  over.value = cell.value = "";
  stretch.value = null;
  forgetFigures();
  const found = await run({ kind: "compare", data: chosen.value, model: model(), ...held.value });
  if (!found) return;
  compared.value = found;
  trial.value = 0; // the worst
}

/** Compare with other data, or with another model: nothing of the form holds any more. */
export async function compareChosen() {
  compared.value = null;
  holdAll();
  await compareAgain();
}

/** Take a model that was learnt, and compare with it. @param {any} found */
async function goOnWith(found) {
  if (!found) return;
  models.value = [...models.value, found];
  made.value = [...made.value, found];
  if (chosen.value.length) await compareChosen();
}

/** @param {boolean} quick for one effect alone */
async function diagnose(quick) {
  diagnosed.value = learnt.value = null;
  const found = await run({ kind: "diagnose", data: chosen.value, model: model(), quick });
  if (found) diagnosed.value = found;
}

/** @param {string[]} effects */
async function adopt(effects) {
  const found = await run({ kind: "adopt", data: chosen.value, diagnosis: diagnosed.value.key, chosen: effects });
  await goOnWith(found);
}

async function learn() {
  const found = await run({ kind: "learn", data: chosen.value, model: model() });
  if (found) learnt.value = found;
}

/** @param {string} law */
async function adoptLaw(law) {
  const found = await run({ kind: "adopt_law", data: chosen.value, model: model(), learnt: learnt.value.key, law });
  await goOnWith(found);
}

/** Ask what is what in dropped recordings. @param {string} upload */
async function guess(upload) {
  const found = await run({ kind: "guess", upload, ...shaft() });
  if (found) propose(upload, found);
}

async function importProposed() {
  const { upload } = proposal.value;
  const found = await run({ kind: "import", upload, mapping: asConfirmed() });
  if (!found) return;
  const key = `imported:${found.key}`;
  proposal.value = null;
  dropped.value = [...dropped.value, { key, name: `${found.name}, ${found.trials} ${found.trials === 1 ? "trial" : "trials"}`, kind: "imported" }];
  chosen.value = [key];
  models.value = [];
  await compareChosen();
}

async function undo() {
  models.value = models.value.slice(0, -1);
  await compareChosen();
}

async function takeValues() {
  await goOnWith(await run({ kind: "take_values", data: chosen.value, model: model() }));
}

/** @param {string} key */
async function startFrom(key) {
  models.value = [];
  start.value = key;
  if (chosen.value.length) await compareChosen();
}

async function cancel() {
  if (job.value?.key) await ask("DELETE", `jobs/${job.value.key}`).catch(() => null);
}

/** Take in dropped files, folders included.
 * @param {DataTransferItemList | FileList} items */
async function take(items) {
  refused.value = "";
  const files = await everyFile(items);
  if (!files.length) return;
  const name = files[0].path.split("/")[0];
  let upload = "";
  let data = 0;
  let opens = false;
  try {
    ({ upload } = await ask("POST", "uploads", { name }));
    proposal.value = null;
    for (const { path, file } of files) {
      job.value = { step: `taking ${path}`, done: 0, total: 0, state: "running" };
      ({ data, model: opens } = await ask("PUT", `uploads/${upload}/${path.split("/").map(encodeURIComponent).join("/")}`, file));
    }
  } catch (error) {
    refused.value = /** @type {Error} */ (error).message;
    return;
  } finally {
    job.value = null;
  }
  if (data) {
    const key = `upload:${upload}`;
    dropped.value = [...dropped.value, { key, name, kind: "upload" }];
    chosen.value = [key];
    models.value = [];
  }
  if (opens) await goOnWith(await run({ kind: "open", upload }));
  else if (data) await compareChosen();
  else await guess(upload);
}

/** @param {DataTransferItemList | FileList} items @returns {Promise<{path: string, file: File}[]>} */
async function everyFile(items) {
  if (items instanceof FileList)
    return [...items].map((file) => ({ path: file.webkitRelativePath || file.name, file }));
  /** @type {{path: string, file: File}[]} */
  const found = [];
  /** @param {any} entry @param {string} folder */
  const walk = async (entry, folder) => {
    if (entry.isFile) {
      const file = await new Promise((done, fail) => entry.file(done, fail));
      if (!file.name.startsWith(".")) found.push({ path: folder + file.name, file });
      return;
    }
    const reader = entry.createReader();
    for (;;) {
      const some = await new Promise((done, fail) => reader.readEntries(done, fail));
      if (!some.length) break;
      for (const one of some) await walk(one, `${folder}${entry.name}/`);
    }
  };
  const entries = [...items].map((item) => item.webkitGetAsEntry()).filter(Boolean);
  for (const entry of entries) await walk(entry, "");
  return found;
}

export function Workbench() {
  useEffect(() => {
    if (!about.value) ask("GET", "about").then((found) => (about.value = found), (error) => (refused.value = error.message));
  }, []);
  return html`<h1>Workbench</h1>
    ${refused.value ? html`<p class="refusal" role="alert">${refused.value}</p>` : null}
    <div class="grid2">
      <${Choose} />
      <${Running} />
      <${WhatIsWhat} busy=${Boolean(job.value)} sources=${about.value?.data ?? []} again=${() => guess(proposal.value.upload)} take=${importProposed} />
      <${Compared} />
      <${Missing} />
      <${Falls} />
    </div>`;
}

function Choose() {
  const all = [...dropped.value, ...(about.value?.data ?? [])];
  const runs = chosen.value.filter((key) => key.startsWith("run:"));
  return html`<section class="card wide"><h2>1 · Data</h2>
    <div class="drop" onDragOver=${(/** @type {DragEvent} */ e) => { e.preventDefault(); /** @type {any} */ (e.currentTarget).classList.add("over"); }}
      onDragLeave=${(/** @type {any} */ e) => e.currentTarget.classList.remove("over")}
      onDrop=${(/** @type {any} */ e) => { e.preventDefault(); e.currentTarget.classList.remove("over"); take(e.dataTransfer.items); }}>
      <ul class="sources">${all.map((source) => html`<li><label class="row"><input type="radio" name="source" checked=${chosen.value[0] === source.key}
        onChange=${() => { chosen.value = [source.key]; models.value = []; compareChosen(); }} /> ${source.name} <span class="quiet">${source.kind}</span></label></li>`)}
        ${runs.length ? html`<li><strong>${runs.length} recorded ${runs.length === 1 ? "run" : "runs"}</strong></li>` : null}</ul>
      <p>Drop a dataset here, as a folder or a ZIP, run files, a model file, or recordings of any kind (CSV, XLSX, MATLAB, HDF5, MCAP, ROS bags, NumPy); or${" "}
        <label class="row">choose files <input type="file" multiple onChange=${(/** @type {any} */ e) => take(e.target.files)} /></label></p>
    </div>
    <p><label>Model to hold against them <select value=${model() ?? ""} onChange=${(/** @type {any} */ e) => startFrom(e.target.value)}>
      <option value="">rigid tissue and uniform friction, both fitted</option>
      ${made.value.map((m) => html`<option value=${m.key}>${words(m.model)}: ${m.added.map(words).join(", ") || "rigid tissue"}</option>`)}
      ${(about.value?.parameters ?? []).map((/** @type {string} */ p) => html`<option value=${p}>${words(p)}</option>`)}</select></label></p></section>`;
}

function Running() {
  const now = job.value;
  if (!now) return null;
  return html`<section class="card wide job" role="status"><strong>${now.step}</strong>
    <progress aria-label=${now.step} max=${now.total || 1} value=${now.total ? now.done : undefined}></progress>
    <span class="quiet">${now.total ? `${now.done} of ${now.total}` : ""} ${now.elapsed_s !== undefined ? `${number(now.elapsed_s, 0)} s` : ""}
      ${now.left_s !== null && now.left_s !== undefined ? ` · about ${number(now.left_s, 0)} s of this step left` : ""}</span>
    ${now.key ? html`<button onClick=${cancel}>Cancel</button>` : null}</section>`;
}

const LEVELS = [2, 3, 6, 15, 50];
const LEVEL_NAMES = ["below 2", "2", "3, the limit", "6", "15", "50 and more"];
/** @param {number} sigmas */
const heat = (sigmas) => `h${LEVELS.filter((limit) => sigmas >= limit).length}`;
const ARROWS = /** @type {Record<string, string>} */ ({ up: " ↑", down: " ↓" });

function Compared() {
  const found = compared.value;
  if (!found) return null;
  return html`<section class="card wide"><h2>2 · Where it fails</h2>
      <p><strong>${found.name}</strong> ${found.sentence}</p>
      <${Errors} found=${found} />
      <${ResidualMap} found=${found} />
      <${Values} found=${found} />
      <${More} found=${found} own=${model() !== null} busy=${Boolean(job.value)} again=${compareAgain} />
      ${found.traces && found.sentences.length ? html`<details><summary>The worst places in words</summary><ul>${found.sentences.map((/** @type {string} */ s) => html`<li>${s}</li>`)}</ul></details>` : null}
      ${found.notes?.length ? html`<details><summary>${found.notes.length} ${found.notes.length === 1 ? "note" : "notes"} on the data</summary><ul>${found.notes.map((/** @type {string} */ s) => html`<li>${s}</li>`)}</ul></details>` : null}
    </section>
    ${found.traces ? html`<${Traces} found=${found} /><${Figures} busy=${Boolean(job.value)} draw=${draw} refuse=${(/** @type {Error} */ e) => (refused.value = e.message)} />` : null}`;
}

/** @param {string} what */
const draw = (what) => run({ kind: "figure", compared: compared.value.key, what });

/** @param {{found: any}} props */
function ResidualMap({ found }) {
  const channels = [...new Set(found.places.map((/** @type {any} */ p) => p.channel))];
  /** @type {Map<string, any>} */
  const columns = new Map(found.places.map((/** @type {any} */ p) => [`${p.motion}|${p.direction ?? ""}|${p.state}`, p]));
  /** @type {Map<string, any>} */
  const at = new Map(found.places.map((/** @type {any} */ p) => [`${p.channel}|${p.motion}|${p.direction ?? ""}|${p.state}`, p]));
  /** @param {any} place @param {string} key */
  const go = (place, key) => {
    cell.value = key;
    if (!found.traces) return;
    const index = found.traces.trials.findIndex((/** @type {any} */ t) => t.file === place.trial);
    const k = index >= 0 ? index : found.traces.trials.findIndex((/** @type {any} */ t) => t.motions.some((/** @type {any} */ m) => m.name === place.motion));
    if (k < 0) return;
    trial.value = k;
    const motion = found.traces.trials[k].motions.find((/** @type {any} */ m) => m.name === place.motion);
    stretch.value = motion ? [Math.max(0, motion.start_s - 0.5), motion.end_s + 0.5] : null;
    document.getElementById(`trace-${place.channel}`)?.scrollIntoView({ block: "center" });
  };
  return html`<p class="quiet map-words">Error in units of the noise, channel by phase.${found.traces ? " Click a cell to see the place in the traces." : ""}
      <span class="levels">${LEVEL_NAMES.map((name, k) => html`<span class=${`h${k}${k === 2 ? " limit" : ""}`}>${name}</span>`)}</span></p>
    <div class="scroll" tabindex="0" role="group" aria-label="Residual map"><table class="map">
    <thead><tr><td></td>${[...columns.values()].map((p) => html`<th scope="col"><span>${words(p.motion)}${ARROWS[p.direction] ?? ""} ${p.state}</span></th>`)}</tr></thead>
    <tbody>${channels.map((channel) => html`<tr><th scope="row">${words(String(channel))}</th>${[...columns.keys()].map((column) => {
      const key = `${channel}|${column}`;
      const place = at.get(key);
      if (!place || place.sigmas === null || place.sigmas === undefined) return html`<td></td>`;
      const text = place.words || `${words(place.channel)}, ${words(place.motion)} ${place.state}: ${number(place.sigmas, 1)} times the noise`;
      return html`<td><button class=${heat(place.sigmas)} title=${text} aria-label=${text} aria-pressed=${cell.value === key}
        onClick=${() => go(place, key)}>${place.sigmas >= 9.95 ? Math.round(place.sigmas) : number(place.sigmas, 1)}</button></td>`;
    })}</tr>`)}</tbody></table></div>`;
}

/** @param {{found: any}} props */
function Traces({ found }) {
  const { channels, trials, of } = found.traces;
  const shown = trials[Math.min(trial.value, trials.length - 1)];
  const k = trials.indexOf(shown);
  const candidate = over.value ? diagnosed.value?.candidates?.[over.value]?.[shown.file] : null;
  return html`<section class="card wide"><h2>Traces</h2>
    <div class="tabs" role="group" aria-label="Trials">${trials.map((/** @type {any} */ t, /** @type {number} */ i) => html`<button aria-pressed=${i === k}
      onClick=${() => { trial.value = i; stretch.value = null; }}>${i + 1} · ${t.title}</button>`)}
      ${stretch.value ? html`<button onClick=${() => (stretch.value = null)}>Whole trial</button>` : null}</div>
    ${trials.length < of ? html`<p class="quiet">${trials.length} of ${of} trials are drawn.</p>` : null}
    ${over.value ? html`<p>Laid over: what <strong>${words(over.value)}</strong> predicts, fitted.</p>` : null}
    <div class="grid2">${channels.map((/** @type {any} */ channel, /** @type {number} */ c) => {
      const noise = 2 * channel.noise;
      const expected = shown.model[c];
      const data = [shown.time_s, shown.measured[c], expected,
        expected.map((/** @type {number|null} */ v) => (v === null ? null : v + noise)),
        expected.map((/** @type {number|null} */ v) => (v === null ? null : v - noise)),
        ...(shown.refit ? [shown.refit[c]] : []), ...(candidate ? [candidate[c]] : [])];
      return html`<div id=${`trace-${channel.name}`}><h3>${words(channel.name)} <span class="quiet">noise ${significant(channel.noise)} ${channel.unit}</span></h3>
        <${Plot} label=${`${channel.name} over time, measured and model`} unit=${`${words(channel.name)} / ${channel.unit}`} height=${200} band=${true} cursor="traces"
          range=${stretch.value} marks=${shown.motions}
          series=${[dots("measured", "--quiet"), line(shown.refit ? "as it stands" : "model", "--model"), line("noise +2σ", "--band", { width: 0.5 }), line("noise −2σ", "--band", { width: 0.5 }),
            ...(shown.refit ? [line("refitted", "--c1", { dash: [5, 4] })] : []), ...(candidate ? [line(`with ${words(over.value)}`, "--other", { width: 2 })] : [])]}
          data=${data} /></div>`;
    })}</div></section>`;
}

function Missing() {
  if (!compared.value) return null;
  const found = diagnosed.value;
  return html`<section class="card wide"><h2>3 · What is missing</h2>
    ${found ? html`<${Verdict} found=${found} />` : html`<p><button class="go" disabled=${Boolean(job.value)} onClick=${() => diagnose(false)}>Diagnose</button>
      <span class="quiet"> tries every effect of the library on commands that were left out</span></p>
      <p><button disabled=${Boolean(job.value)} onClick=${() => diagnose(true)}>Diagnose quickly</button>
      <span class="quiet"> one effect alone, in half the time or less</span></p>`}</section>`;
}

/** @param {{found: any}} props */
function Verdict({ found }) {
  const choices = found.verdict !== "effect" ? [] : found.ties.length ? [...found.effects, ...found.ties] : [""];
  const values = found.model_values;
  return html`${values ? html`<h3>Its values</h3><ul aria-label="Its values">${values.sentences.map((/** @type {string} */ s) => html`<li>${s}</li>`)}</ul>
      ${values.contradict ? html`<p><button class=${found.verdict === "none" ? "go" : ""} disabled=${Boolean(job.value)} onClick=${takeValues}>Take these values over</button>
        ${found.verdict === "none" ? "" : html` <span class="quiet"> of this structure, which lacks something</span>`}</p>` : null}<h3>Its structure</h3>` : null}
    <p class="verdict">${found.sentence.charAt(0).toUpperCase() + words(found.sentence.slice(1))}</p>
    <p>${found.errors_sentence}</p>
    ${found.quick ? html`<p>One effect alone was looked for. <button disabled=${Boolean(job.value)} onClick=${() => diagnose(false)}>Look for several</button></p>` : null}
    ${found.reasons.length ? html`<ul>${found.reasons.map((/** @type {any} */ r) => html`<li>${r.sentence ?? r.text ?? words(String(r.rule ?? r.name ?? ""))}</li>`)}</ul>` : null}
    <p>${choices.map((effect) => html`<button class="go" disabled=${Boolean(job.value)} onClick=${() => adopt(effect ? [effect] : [])}>
      Add ${words(effect || found.effects.join(" and "))}</button> `)}</p>
    ${found.next_experiment ? html`<p><strong>Would tell them apart:</strong> ${found.next_experiment.sentence}</p>` : null}
    <div class="scroll" tabindex="0" role="group" aria-label="Ranking"><table><thead><tr><th class="text">effect</th><th>held-out error / noise</th><th>error removed</th><th class="text">for and against</th></tr></thead>
      <tbody>${found.ranking.slice(0, everyRow.value ? undefined : SHOWN_ROWS).map((/** @type {any} */ row) => html`<tr class=${found.effects.includes(row.effect) ? "named" : ""}>
        <th scope="row">${found.candidates[row.effect] ? html`<button aria-pressed=${over.value === row.effect}
            onMouseEnter=${() => (over.value = row.effect)} onFocus=${() => (over.value = row.effect)}
            onClick=${() => (over.value = row.effect)}>${words(row.effect)}</button>` : words(row.effect)}</th>
        <td>${number(row.held_out_error, 2)}</td><td>${number(100 * row.error_removed, 0)} %</td>
        <td class="text">${row.in_favour}${row.against ? html`; against: ${row.against}` : null}
          ${Object.entries(row.parameters).map(([name, v]) => html`<br /><span class="quiet">${parameter(name)} = ${significant(/** @type {any} */ (v).value)} (95 %: ${significant(/** @type {any} */ (v).low)} to ${significant(/** @type {any} */ (v).high)}) ${/** @type {any} */ (v).unit === "1" ? "" : /** @type {any} */ (v).unit}</span>`)}</td></tr>`)}</tbody></table></div>
    ${found.ranking.length > SHOWN_ROWS ? html`<p><button aria-expanded=${everyRow.value} onClick=${() => (everyRow.value = !everyRow.value)}>${everyRow.value ? "Fewer" : `The other ${found.ranking.length - SHOWN_ROWS}`}</button></p>` : null}
    ${learnt.value ? html`<${LearntLaws} found=${learnt.value} busy=${Boolean(job.value)} add=${adoptLaw} />`
      : found.verdict === "unknown" || found.verdict === "cannot_tell" ? html`<p><button class="go" disabled=${Boolean(job.value)} onClick=${learn}>Learn the law</button>
        <span class="quiet"> searches where it acts, on what it depends, its curve and a formula; minutes</span></p>` : null}
    ${found.left_over.length ? html`<h3>Left over</h3><ul>${found.left_over.map((/** @type {string} */ s) => html`<li>${s}</li>`)}</ul>` : null}
    ${found.notes.length ? html`<details><summary>Notes</summary><ul>${found.notes.map((/** @type {string} */ s) => html`<li>${s}</li>`)}</ul></details>` : null}`;
}

function Falls() {
  const now = models.value.at(-1);
  if (!now) return null;
  const steps = now.steps;
  const most = Math.max(...steps.map((/** @type {any} */ s) => s.held_out_error ?? s.training_error ?? 0), 1);
  const names = Object.keys(steps.at(-1)?.channels ?? {});
  const known = steps.some((/** @type {any} */ s) => (s.held_out_error ?? s.training_error) !== null);
  return html`<section class="card wide"><h2>4 · ${known ? "The error falls" : "The model"}</h2>
    ${known ? html`<p>Error on commands left out, in units of the noise; the line is the noise.</p>
    <div class="bars">${steps.map((/** @type {any} */ step, /** @type {number} */ k) => {
      const error = step.held_out_error ?? step.training_error;
      return html`<span>${words(step.step)}</span>
        <svg viewBox="0 0 100 10" preserveAspectRatio="none" role="img" aria-label=${`${number(error, 2)} times the noise`}><rect class=${k ? "fill after" : "fill"} x="0" y="1" width=${(100 * error) / most} height="8" /><line class="floor" x1=${100 / most} x2=${100 / most} y1="0" y2="10" vector-effect="non-scaling-stroke" /></svg>
        <strong>${number(error, 2)}</strong>`;
    })}</div>
    <div class="scroll" tabindex="0" role="group" aria-label="Errors by channel"><table><thead><tr><th>channel</th>${steps.map((/** @type {any} */ s) => html`<th>${words(s.step)}</th>`)}<th>noise floor</th></tr></thead>
      <tbody>${names.map((name) => html`<tr><th scope="row">${words(name.replace(/_(nmm|deg)$/, ""))} / ${name.endsWith("_nmm") ? "N·mm" : "°"}</th>
        ${steps.map((/** @type {any} */ s) => html`<td>${significant(s.channels[name]?.held_out_after ?? s.channels[name]?.training_after)}</td>`)}
        <td>${significant(steps.at(-1).channels[name]?.floor)}</td></tr>`)}</tbody></table></div>` : null}
    <h3>Model ${now.model}</h3>
    <ul>${now.values.filter((/** @type {any} */ v) => v.value !== null).map((/** @type {any} */ v) => html`<li>${parameter(v.name)} = ${measured(v.value, v.uncertainty)} ${v.unit === "1" ? "" : v.unit}</li>`)}</ul>
    <p><button onClick=${undo} disabled=${Boolean(job.value)}>Undo</button>
      <button onClick=${() => save(`jobs/${now.key}/model.yaml`, `${now.model}.yaml`).catch((error) => (refused.value = error.message))}>Model file</button></p></section>`;
}
