// Each effect: its law and source, and what its parameters change in a standard trial.
import { ask } from "./net.js";
import { Plot, line } from "./plot.js";
import { about, chosen } from "./workbench.js";
import { batch, html, signal, significant, number, useEffect, words } from "./ui.js";

/** @type {{value: any[] | null}} */
const effects = signal(null);
/** Why an effect of one's own cannot be used, a sentence each. @type {{value: string[]}} */
const broken = signal([]);
const name = signal("");
/** @type {{value: Record<string, number>}} */
const values = signal({});
/** @type {{value: any}} */
const lesson = signal(null);
const refused = signal("");
/** Key of the data whose shaft is used; empty for the paper's. */
const shaft = signal("");
let asking = false;
let again = false;

/** One question at a time; a slider that moves on asks once more at the end. */
async function redraw() {
  if (asking) {
    again = true;
    return;
  }
  asking = true;
  try {
    lesson.value = await ask("POST", "lesson", { effect: name.value, values: values.value, data: shaft.value || null });
    refused.value = "";
  } catch (error) {
    refused.value = /** @type {Error} */ (error).message;
  }
  asking = false;
  if (again) {
    again = false;
    redraw();
  }
}

/** @param {any} effect */
function choose(effect) {
  batch(() => {
    name.value = effect.name;
    lesson.value = null;
    values.value = Object.fromEntries(effect.parameters.map((/** @type {any} */ p) => [p.name, p.typical]));
  });
  redraw();
}

/** A slider's 0 … 100 stands for the plausible range, on the parameter's own scale. @param {any} p */
export function scale(p) {
  const ends = [p.typical, ...p.literature.filter((/** @type {any} */ v) => v !== null)];
  const low = Math.max(p.lower, Math.min(...ends));
  const high = Math.min(p.upper ?? Infinity, Math.max(...ends, p.scale === "linear" ? 2 * p.typical : p.typical));
  const bent = p.scale !== "linear" && low > 0;
  return {
    low,
    high,
    /** @param {number} v */
    place: (v) => 100 * (bent ? Math.log(v / low) / Math.log(high / low) : (v - low) / (high - low || 1)),
    /** @param {number} s */
    value: (s) => Number((bent ? low * (high / low) ** (s / 100) : low + (s / 100) * (high - low)).toPrecision(4)),
  };
}

/** Data with traces: what was chosen in the workbench, and what is listed. @returns {{key: string, name: string}[]} */
function sources() {
  const listed = (about.value?.data ?? []).filter((/** @type {any} */ s) => s.kind !== "published");
  const more = chosen.value.filter((key) => !listed.some((/** @type {any} */ s) => s.key === key)).slice(0, 1);
  return [...more.map((key) => ({ key, name: "the workbench's data" })), ...listed];
}

export function Learn() {
  useEffect(() => {
    if (!about.value) ask("GET", "about").then((found) => (about.value = found), () => null);
    if (effects.value) return;
    ask("GET", "effects").then((found) => { effects.value = found.effects; broken.value = found.broken; choose(found.effects[0]); }, (error) => (refused.value = error.message));
  }, []);
  const effect = effects.value?.find((e) => e.name === name.value);
  return html`<h1>Learn</h1>
    ${refused.value ? html`<p class="refusal" role="alert">${refused.value}</p>` : null}
    <div class="side"><section class="card"><h2>Effects</h2>
      ${effects.value ? html`<ul class="list">${effects.value.map((e) => html`<li><button aria-pressed=${e.name === name.value} title=${e.first} onClick=${() => choose(e)}>${words(e.name)}</button></li>`)}</ul>` : html`<p class="quiet">Loading; the first time the solver is compiled.</p>`}
      ${broken.value.length ? html`<div role="alert"><p class="lacks">Cannot be used, until mended:</p><ul aria-label="Broken effects">${broken.value.map((text) => html`<li>${text}</li>`)}</ul></div>` : null}</section>
    ${effect ? html`<div><section class="card"><h2>${words(effect.name)}</h2><pre class="law">${effect.text}</pre>
      ${effect.relatives.length ? html`<p class="quiet">Looks like: ${effect.relatives.map(words).join(", ")}.</p>` : null}
      ${effect.redundant_with.length ? html`<p class="quiet">Cannot be told apart from: ${effect.redundant_with.map(words).join(", ")}.</p>` : null}
      <label>On the shaft of <select value=${shaft.value} onChange=${(/** @type {any} */ e) => { shaft.value = e.target.value; redraw(); }}>
        <option value="" selected=${!shaft.value}>the experiment of the paper</option>${sources().map((s) => html`<option value=${s.key} selected=${s.key === shaft.value}>${s.name}</option>`)}</select></label>
      <div class="sliders">${effect.parameters.map((/** @type {any} */ p) => {
        const on = scale(p);
        const value = values.value[p.name];
        return html`<label>${p.words}: ${significant(value)} ${p.unit === "1" ? "" : p.unit}
          <input type="range" min="0" max="100" step="0.5" value=${on.place(value)} aria-valuetext=${`${significant(value)} ${p.unit}`}
            onInput=${(/** @type {any} */ e) => { values.value = { ...values.value, [p.name]: on.value(Number(e.target.value)) }; redraw(); }} />
          <span>${significant(on.low)} to ${significant(on.high)}, typical ${significant(p.typical)}${p.shapes ? ", gives form only" : ""}</span></label>`;
      })}</div></section>
      ${lesson.value ? html`<${Trial} found=${lesson.value} />` : null}</div>` : null}</div>`;
}

/** @param {{found: any}} props */
function Trial({ found }) {
  const starts = found.phases.map((/** @type {any} */ p, /** @type {number} */ k) => ({ ...p, end_s: found.phases[k + 1]?.start_s ?? found.time_s.at(-1) }));
  return html`<section class="card"><h2>Change against the null model, in units of the noise</h2>
    <p class="quiet">A compensation to 45° on ${found.shaft}; noise ${significant(found.channels[0].noise)} N·mm and ${significant(found.channels[1].noise)}°.</p>
    <div class="scroll" tabindex="0" role="group" aria-label="Change by channel"><table><thead><tr><th>channel</th>${found.channels.map((/** @type {any} */ c) => html`<th>${words(c.name)}</th>`)}</tr></thead>
      <tbody><tr><th scope="row">root mean square / noise</th>${found.channels.map((/** @type {any} */ c) => html`<td>${number(c.rms_sigmas, 1)}</td>`)}</tr>
      <tr><th scope="row">most / noise</th>${found.channels.map((/** @type {any} */ c) => html`<td>${number(c.most_sigmas, 1)}</td>`)}</tr></tbody></table></div>
    <${Plot} label="Change against the null model by channel" unit="change / noise" height=${200} cursor="learn" marks=${starts}
      series=${found.channels.map((/** @type {any} */ c, /** @type {number} */ k) => line(words(c.name), `--c${k}`))} data=${[found.time_s, ...found.channels.map((/** @type {any} */ c) => c.sigmas)]} />
    <div class="grid2">${found.channels.map((/** @type {any} */ c) => html`<div><h3>${words(c.name)}</h3>
      <${Plot} label=${`${c.name} with and without the effect`} unit=${`${words(c.name)} / ${c.unit}`} height=${170} cursor="learn" marks=${starts}
        series=${[line("null model", "--quiet"), line("with the effect", "--model")]} data=${[found.time_s, c.null, c.effect]} /></div>`)}</div></section>`;
}
