// The circle by clicks: data, where the model fails, what is missing, add it, the error falls.
import { asked, busy, found, ofSubject, recording } from "./found.js";
import { Working, begin, done } from "./jobs.js";
import { WhatIsWhat, asConfirmed, proposal, propose, shaft } from "./mapping.js";
import { Missing } from "./missing.js";
import { Falls } from "./models.js";
import { Opening } from "./opening.js";
import { ask } from "./net.js";
import { Compared } from "./residuals.js";
import { take, taking } from "./taking.js";
import { about, dataOf, dataRoute, heldModel, look, lost, modelCalled, place, refuse, route, said, subject } from "./store.js";
import { effect, html, signal, untracked, words, written } from "./ui.js";

effect(() => {
  const { guess } = found.value;
  const data = subject.value?.data[0];
  const none = !recording.value;
  untracked(() => {
    if (guess && data) propose(data.key.replace("upload:", ""), guess);
    else if (none) proposal.value = null;
  });
});

const guessAgain = () => proposal.value && begin({ kind: "guess", upload: proposal.value.upload, ...shaft() });

async function importProposed() {
  if (!proposal.value) return;
  const { upload, mapping } = proposal.value;
  const of = subject.value;
  const job = await done({ kind: "import", upload, mapping: asConfirmed(mapping) });
  if (!job) return;
  await look();
  const imported = dataOf(`imported:${job.key}`);
  if (imported && subject.value?.id === of?.id) location.hash = dataRoute([imported]);
}

export function Workbench() {
  return html`<h1>Workbench</h1><p class="purpose">Find out where a model of the needle fails on your data, what it lacks, and add that to it.</p>
    ${lost.value ? html`<p class="refusal" role="alert">${lost.value}</p>` : null}
    <div class="grid2">
      <${Choose} />
      ${subject.value || lost.value ? null : html`<${Opening} />`}
      <${WhatIsWhat} busy=${busy.value} sources=${about.value?.data ?? []} machines=${about.value?.machines ?? []} again=${guessAgain} take=${importProposed} discard=${() => proposal.value && forget(proposal.value.upload)} />
      <${Compared} />
      <${Missing} />
      <${Falls} />
    </div>`;
}

/** @param {Event} event */
const target = (event) => /** @type {HTMLElement} */ (event.currentTarget);

/** @param {string} upload */
async function forget(upload) {
  try {
    await ask("DELETE", `uploads/${upload}`);
    await look();
    if (subject.value === null && place.value.name) location.hash = route("data");
  } catch (error) {
    refuse(error);
  }
}

function Choose() {
  const all = about.value?.data ?? [];
  const present = subject.value?.data ?? [];
  const runs = present.filter((one) => one.key.startsWith("run:"));
  return html`<section class="card wide"><h2>1 · Data</h2>
    <div class="drop" onDragOver=${(/** @type {DragEvent} */ e) => { e.preventDefault(); target(e).classList.add("over"); }}
      onDragLeave=${(/** @type {Event} */ e) => target(e).classList.remove("over")}
      onDrop=${(/** @type {DragEvent} */ e) => { e.preventDefault(); target(e).classList.remove("over"); if (e.dataTransfer) take(e.dataTransfer.items); }}>
      <ul class="sources">${all.map((source) => html`<li key=${source.key}><label class="row"><input type="radio" name="source" checked=${present[0]?.key === source.key}
        onChange=${() => (location.hash = dataRoute([source], heldModel.value))} /> ${source.name} <span class="quiet">${source.kind}</span></label>${source.key.startsWith("upload:") ? html`
        <button class="small" aria-label=${`Remove ${source.name}`} onClick=${() => forget(source.key.replace("upload:", ""))}>×</button>` : null}</li>`)}
        ${runs.length ? html`<li><strong>${runs.length} recorded ${runs.length === 1 ? "run" : "runs"}</strong>: ${runs.map((one, k) => html`${k ? ", " : ""}<a href=${route("runs", one.name)}>${one.name}</a>`)}</li>` : null}</ul>
      <p>Drop a dataset here, as a folder or a ZIP, run files, a model file, or recordings of any kind (CSV, XLSX, MATLAB, HDF5, MCAP, ROS bags, NumPy); or${" "}
        <label class="button file">choose files<input class="hidden" type="file" multiple onChange=${(/** @type {Event} */ e) => take(/** @type {FileList} */ (/** @type {HTMLInputElement} */ (e.target).files))} /></label></p>
      ${taking.value ? html`<p role="status">Taking ${taking.value} …</p>` : null}
    </div>
    <p><label>Model to hold against them <select value=${heldModel.value?.name ?? ""} onChange=${(/** @type {Event} */ e) => (location.hash = present.length ? dataRoute(present, modelCalled(written(e))) : route("data", "", written(e) ? [["model", written(e)]] : []))}>
      <option value="">rigid tissue and uniform friction, both fitted</option>
      ${(about.value?.models ?? []).map((m) => html`<option value=${m.name} selected=${m.name === heldModel.value?.name}>${words(m.name)}: ${m.added.map(words).join(", ") || "rigid tissue"}</option>`)}
      ${(about.value?.parameters ?? []).map((/** @type {string} */ p) => html`<option value=${p} selected=${p === heldModel.value?.name}>${words(p)}</option>`)}</select></label></p>
    <${Working} kinds=${["compare", "guess", "import"]} of=${ofSubject.value} /></section>`;
}
