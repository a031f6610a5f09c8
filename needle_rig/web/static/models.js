// Models that were learnt or dropped: the ladder of their errors, their values, and where they come from.
import { done, result } from "./jobs.js";
import { ask, save } from "./net.js";
import { about, dataRoute, heldModel, look, place, refuse, route, subject } from "./store.js";
import { take } from "./taking.js";
import { distance, effect, html, measured, number, parameter, signal, significant, untracked, words } from "./ui.js";

/** The model whose document is shown, by key. @type {{value: {key: string, document: Learnt} | null}} */
const shown = signal(null);

/** What is known of a model that was learnt; null for a parameter set. @param {string | undefined} key */
export const learnt = (key) => about.value?.models.find((m) => m.key === key) ?? null;

/** The model of the address. */
const wanted = () => {
  const { view, name } = place.value;
  if (view === "data") return heldModel.value?.key;
  return view === "models" ? about.value?.models.find((m) => m.name === name)?.key : undefined;
};
effect(() => {
  const key = wanted();
  if (!key || !learnt(key) || untracked(() => shown.value)?.key === key) return;
  result(key).then((document) => {
    if (wanted() === key) shown.value = { key, document };
  }, refuse);
});

/** The document of this model, once it came. @param {string | undefined} key */
const document_ = (key) => (shown.value && shown.value.key === key ? shown.value.document : null);

/** The model that is held against the present data: how its error fell, and the way back. */
export function Falls() {
  const of = subject.value;
  const model = learnt(of?.model?.key);
  const now = document_(model?.key);
  if (!of || !model || !now) return null;
  return html`<section class="card wide"><h2>4 · ${isKnown(now) ? "The error falls" : "The model"}</h2>
    <${Ladder} now=${now} />
    <p class="buttons"><a class="button go" href=${route("live", "", [["model", model.name]])}>Use this model on the rig</a> <${Undo} model=${model} now=${now} to=${(/** @type {Named | null} */ before) => dataRoute(of.data, before)} />
      <${Rigs} model=${model} /> <${File} model=${model} /> <a href=${route("models", model.name)}>All about this model</a></p></section>`;
}

/** Whether the last step of this model was taken elsewhere: an opened file has its steps inside. @param {Job} model @param {Learnt} now */
const cameWithSteps = (model, now) => ["open", "undo"].includes(model.kind) && now.steps.length > 1;

/** The way back to the model before; what was found of that stands there still.
 * @param {{model: Job, now: Learnt, to: (before: Named | null) => string}} props */
function Undo({ model, now, to }) {
  const take = async () => {
    const job = await done({ kind: "undo", model: model.key });
    if (!job) return;
    await look();
    location.hash = to(job.name ? { key: job.key, name: job.name } : null);
  };
  if (cameWithSteps(model, now)) return html`<button onClick=${take}>Undo</button>`;
  return model.kind === "open" || model.kind === "undo" ? null : html`<a class="button" href=${to(model.model)}>Undo</a>`;
}

/** Set the model that orders plan with; null is that of the rig file. @param {string | null} key */
const setRigs = (key) => ask("PUT", "rig_model", { model: key }).then(look, refuse);

/** Whether this is the rig's model, and a way to change it. @param {{model: Job}} props */
const Rigs = ({ model }) => (about.value?.rig_model?.key === model.key
  ? html`<span class="tag">the rig's model</span> <button onClick=${() => setRigs(null)}>No longer the rig's</button>`
  : html`<button title="Orders plan with it, unless they name another" onClick=${() => setRigs(model.key)}>Set as the rig's</button>`);

/** @param {{model: Job}} props */
const File = ({ model }) => html`<button onClick=${() => save(`jobs/${model.key}/model.yaml`, `${model.name}.yaml`).catch(refuse)}>Model file</button>`;

/** @param {Learnt} now */
const isKnown = (now) => now.steps.some((s) => (s.held_out_error ?? s.training_error) !== null);

/** What a step of a model's history is called. @param {Step} step */
const called = ({ step }) => (step === "null" ? "null model" : words(step));

/** @param {{now: Learnt}} props */
function Ladder({ now }) {
  const steps = now.steps;
  const most = Math.max(...steps.map((s) => s.held_out_error ?? s.training_error ?? 0), 1);
  const names = Object.keys(steps.at(-1)?.channels ?? {});
  return html`${isKnown(now) ? html`<p>Prediction error on unseen trials, in units of the sensor noise; the line is the noise.</p>
    <div class="bars">${steps.map((step, k) => {
      const error = step.held_out_error ?? step.training_error;
      return html`<span>${called(step)}</span>
        <svg viewBox="0 0 100 10" preserveAspectRatio="none" role="img" aria-label=${`${number(error, 2)} times the noise`}><rect class=${k ? "fill after" : "fill"} x="0" y="1" width=${(100 * (error ?? 0)) / most} height="8" /><line class="floor" x1=${100 / most} x2=${100 / most} y1="0" y2="10" vector-effect="non-scaling-stroke" /></svg>
        <strong>${number(error, 2)}</strong>`;
    })}</div>
    <div class="scroll" tabindex="0" role="group" aria-label="Errors by channel"><table><thead><tr><th>channel</th>${steps.map((s) => html`<th>${called(s)}</th>`)}<th>noise floor</th></tr></thead>
      <tbody>${names.map((name) => html`<tr><th scope="row">${words(name.replace(/_(nmm|deg)$/, ""))} / ${name.endsWith("_nmm") ? "N·mm" : "°"}</th>
        ${steps.map((s) => html`<td>${significant(s.channels[name]?.held_out_after ?? s.channels[name]?.training_after)}</td>`)}
        <td>${significant(steps.at(-1)?.channels[name]?.floor)}</td></tr>`)}</tbody></table></div>` : null}
    <h3>Model ${now.model}</h3>
    <ul>${now.values.filter((v) => v.value !== null).map((v) => html`<li>${parameter(v.name)} = ${measured(Number(v.value), v.uncertainty)} ${v.unit === "1" ? "" : v.unit}</li>`)}</ul>`;
}

/** Names of two models at most that are marked, to be compared. @type {{value: string[]}} */
const marked = signal([]);
/** Documents of the models that stand side by side. @type {{value: {id: string, documents: Learnt[]}}} */
const pair = signal({ id: "", documents: [] });
/** @typedef {{name: string, value: number | null, uncertainty: number | null, unit: string}} Value */
/** @typedef {{training_after?: number, held_out_after?: number, floor?: number}} Channel */
/** @typedef {{step: string, held_out_error: number | null, training_error: number | null, channels: Record<string, Channel>}} Step */
/** @typedef {{model: string, steps: Step[], values: Value[], added: string[]}} Learnt */
/** @typedef {import("./types").JobDocument} Job */
/** @typedef {import("./types").Named} Named */

/** The models of the address that stand side by side. */
const beside = () => (place.value.view === "models" && !place.value.name ? place.value.query.getAll("model") : []);
effect(() => {
  const names = beside();
  /** @type {Job[]} */
  const all = about.value?.models ?? [];
  const keys = names.map((name) => all.find((m) => m.name === name)?.key);
  if (keys.length !== 2 || keys.some((key) => !key)) return;
  const id = JSON.stringify(names);
  Promise.all(keys.map((key) => result(/** @type {string} */ (key)))).then((documents) => {
    if (JSON.stringify(beside()) === id) pair.value = { id, documents };
  }, refuse);
});

/** @param {Learnt} of */
const lastError = (of) => of.steps.map((step) => step.held_out_error ?? step.training_error).filter((error) => error !== null).at(-1) ?? null;

/** Two models, value by value. @param {{names: string[]}} props */
function Pair({ names }) {
  if (pair.value.id !== JSON.stringify(names)) return html`<h1>Models side by side</h1><p class="quiet" role="status">Loading …</p><p><a href="#/models">All models</a></p>`;
  const [one, other] = pair.value.documents;
  const all = [...new Set([...one.values, ...other.values].filter((v) => v.value !== null).map((v) => v.name))];
  /** @param {Learnt} of @param {string} name */
  const valueOf = (of, name) => of.values.find((v) => v.name === name && v.value !== null);
  /** @param {Value | undefined} a @param {Value | undefined} b */
  const apart = (a, b) => {
    if (!a || !b || a.value === null || b.value === null) return html`<td>–</td>`;
    const spread = Math.hypot(a.uncertainty ?? 0, b.uncertainty ?? 0);
    const sigmas = spread > 0 ? (b.value - a.value) / spread : null;
    return html`<td class=${sigmas !== null && Math.abs(sigmas) > 3 ? "doubt" : ""}>${sigmas === null ? "–" : distance(sigmas)}</td>`;
  };
  return html`<h1>Models side by side</h1><section class="card"><div class="scroll" tabindex="0" role="group" aria-label="Two models"><table class="values">
      <thead><tr><th scope="col" class="text">value</th>${names.map((name) => html`<th scope="col"><a href=${route("models", name)}>${words(name)}</a></th>`)}<th scope="col">apart</th></tr></thead>
      <tbody><tr><th scope="row">prediction error / noise</th>${[one, other].map((of) => html`<td>${number(lastError(of), 2)}</td>`)}<td>–</td></tr>
        ${all.map((name) => {
          const [a, b] = [valueOf(one, name), valueOf(other, name)];
          const unit = (a ?? b)?.unit;
          return html`<tr><th scope="row">${parameter(name)}${unit && unit !== "1" ? html` <span class="quiet">/ ${unit}</span>` : null}</th>
            ${[a, b].map((v) => html`<td>${v ? measured(/** @type {number} */ (v.value), v.uncertainty) : "not in it"}</td>`)}${apart(a, b)}</tr>`;
        })}</tbody></table></div><p><a href="#/models">All models</a></p></section>`;
}

/** The library: every model, or one of them, or two. */
export function Models() {
  const { name } = place.value;
  /** @type {Job[]} */
  const all = about.value?.models ?? [];
  if (name) return html`<${One} model=${all.find((m) => m.name === name)} name=${name} />`;
  if (beside().length === 2) return html`<${Pair} names=${beside()} />`;
  const chosen = marked.value.filter((one) => all.some((m) => m.name === one));
  const toggle = (/** @type {string} */ one) => (marked.value = chosen.includes(one) ? chosen.filter((m) => m !== one) : [...chosen, one].slice(-2));
  return html`<h1>Models</h1><p class="purpose">Models that were learnt in the workbench, or opened as files: compare them, and use one on the rig.</p><section class="card">
    <div class="orders"><button aria-disabled=${chosen.length !== 2} onClick=${() => chosen.length === 2 && (location.hash = route("models", "", chosen.map((one) => ["model", one])))}>Side by side</button>
      <label class="button file">Open a model file<input class="hidden" type="file" accept=".yaml,.yml" onChange=${(/** @type {Event} */ e) => take(/** @type {FileList} */ (/** @type {HTMLInputElement} */ (e.target).files))} /></label></div>
    ${all.length ? html`<div class="scroll" tabindex="0" role="group" aria-label="Models"><table class="marked stacked rows"><thead><tr><th><span class="hidden">marked</span></th><th scope="col" class="text">model</th><th scope="col" class="text">effects</th><th scope="col" class="text">learnt from</th><th scope="col" class="text">made</th></tr></thead>
      <tbody>${[...all].reverse().map((m) => html`<tr key=${m.key}><td><input type="checkbox" aria-label=${`Mark ${words(m.name)}`} checked=${chosen.includes(m.name)} onChange=${() => toggle(m.name)} /></td><th scope="row" class="text"><a href=${route("models", m.name)}>${words(m.name)}</a>${m.model ? html` <span class="quiet">from ${words(m.model.name)}</span>` : null}${about.value?.rig_model?.key === m.key ? html` <span class="tag">the rig's</span>` : null}</th>
        <td class="text" data-label="effects">${m.added.map(words).join(", ") || "rigid tissue"}</td><td class="text" data-label="learnt from">${from(m)}</td><td class="text" data-label="made">${made(m)}</td></tr>`)}</tbody></table></div>`
      : html`<p class="quiet">None yet. <a href="#/data">Choose data in the workbench</a>, diagnose, and add what is missing.</p>`}</section>`;
}

/** @param {Job} m */
const from = (m) => (m.kind === "open" ? "a file" : m.kind === "undo" ? words(m.model?.name ?? "") : m.data.map((d) => d.name).join(", "));
/** What a step made of the model before it. @param {Job} step @param {Job | undefined} before */
function stepped(step, before) {
  if (step.kind === "open") return words(step.name);
  if (step.kind === "undo") return "− the last step";
  const added = step.added.filter((/** @type {string} */ effect) => !before?.added.includes(effect));
  return added.length ? `+ ${added.map(words).join(" + ")}` : "values taken over";
}

/** @param {Job} m */
const made = (m) => new Date(m.begun_utc_s * 1000).toLocaleString();

/** @param {{model: Job | undefined, name: string}} props */
function One({ model, name }) {
  if (!about.value) return html`<h1>Models</h1><p class="quiet">Loading …</p>`;
  if (!model) return html`<h1>Models</h1><p class="refusal" role="alert">${name}: no such model here. <a href="#/models">All models</a></p>`;
  const now = document_(model.key);
  /** @type {Job[]} */
  const line = [];
  for (let step = /** @type {Job | null} */ (model); step; step = learnt(step.model?.key)) line.unshift(step);
  return html`<h1>${words(name)}</h1><section class="card"><p>Learnt from ${from(model)}, ${made(model)}.</p>
    <p>History: ${line[0].kind === "open" ? "a file" : line[0].model ? words(line[0].model.name) : "the null model"}${line.map((step, k) => html` → ${step === model ? html`<strong>${stepped(step, line[k - 1])}</strong>` : html`<a href=${route("models", step.name)}>${stepped(step, line[k - 1])}</a>`}`)}</p>
    ${now ? html`<${Ladder} now=${now} />` : html`<p class="quiet">Loading …</p>`}
    <p class="buttons"><a class="button go" href=${route("live", "", [["model", name]])}>Use this model on the rig</a> ${model.data.length && model.kind !== "open" ? html`<a class="button" href=${dataRoute(model.data, model)}>Hold against its data</a>` : null}
      <a class="button" href=${route("data", "", [["model", name]])}>Hold against other data</a>
      <a class="button" href=${route("strategies", "", [["model", name]])}>Compare strategies on it</a> <${Rigs} model=${model} /> <${File} model=${model} />
      ${now ? html`<${Undo} model=${model} now=${now} to=${(/** @type {Named | null} */ before) => (model.data.length && model.kind !== "open" ? dataRoute(model.data, before) : before ? route("models", before.name) : route("models"))} />` : null}</p></section>`;
}
