// Each effect: its law and source, and what its parameters change in a standard trial.
import { ask } from "./net.js";
import { Legend, Plot, line } from "./plot.js";
import { about, heldData, place, refuse, route } from "./store.js";
import { batch, effect, html, signal, significant, number, untracked, useEffect, typeset, words, written } from "./ui.js";

/** @typedef {import("./types").EffectDocument} Effect */
/** @type {{value: Effect[] | null}} */
const effects = signal(null);
/** Why an effect of one's own cannot be used, a sentence each. @type {{value: string[]}} */
const broken = signal([]);
const name = signal("");
/** @type {{value: Record<string, number>}} */
const values = signal({});
/** @type {{value: import("./types").LessonDocument | null}} */
const lesson = signal(null);
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
  } catch (error) {
    refuse(error);
  }
  asking = false;
  if (again) {
    again = false;
    redraw();
  }
}

/** @param {Effect} one */
function choose(one) {
  batch(() => {
    name.value = one.name;
    lesson.value = null;
    values.value = Object.fromEntries(one.parameters.map((p) => [p.name, p.typical]));
  });
  redraw();
}

effect(() => {
  // the effect of the address, or else the first
  if (place.value.view !== "effects" || !effects.value) return;
  const one = place.value.name ? effects.value.find((e) => e.name === place.value.name) : effects.value[0];
  if (one) untracked(() => one.name === name.value || choose(one));
});

/** A slider's 0 … 100 stands for the plausible range, on the parameter's own scale. @param {Effect["parameters"][number]} p */
export function scale(p) {
  const ends = [p.typical, ...p.literature.filter((v) => v !== null)];
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

/** Data with traces: what was chosen in the workbench last, and what is listed. @returns {{key: string, name: string}[]} */
function sources() {
  const listed = (about.value?.data ?? []).filter((s) => s.kind !== "published" && s.kind !== "recording");
  const more = heldData.value.filter((one) => !listed.some((s) => s.key === one.key)).slice(0, 1);
  return [...more, ...listed];
}

export function Effects() {
  useEffect(() => {
    if (!effects.value) ask("GET", "effects").then((found) => { effects.value = found.effects; broken.value = found.broken; }, refuse);
  }, []);
  const effect = effects.value?.find((e) => e.name === (place.value.name || name.value));
  return html`<h1>Effects</h1><p class="purpose">See what each effect of the library does to torque and angles.</p>
    ${effects.value && place.value.name && !effect ? html`<p class="refusal" role="alert">${place.value.name}: no such effect in the library. Choose from the list.</p>` : null}
    <div class="side"><section class="card"><h2>Effects</h2>
      ${effects.value ? html`<ul class="list">${effects.value.map((e) => html`<li><a aria-current=${e.name === effect?.name ? "true" : undefined} title=${e.first} href=${route("effects", e.name)}>${words(e.name)}</a></li>`)}</ul>` : html`<p class="quiet">Loading; the first time the solver is compiled.</p>`}
      ${broken.value.length ? html`<div role="alert"><p class="lacks">Cannot be used, until mended:</p><ul aria-label="Broken effects">${broken.value.map((text) => html`<li>${text}</li>`)}</ul></div>` : null}</section>
    ${effect ? html`<div><section class="card"><h2>${words(effect.name)}</h2>${effect.text.split(/\n\s*\n/).map((part) => (/^ {2}/m.test(part) ? html`<pre class="law">${part}</pre>` : html`<p>${typeset(part.replaceAll("\n", " "))}</p>`))}
      ${effect.relatives.length ? html`<p class="quiet">Looks like: ${effect.relatives.map(words).join(", ")}.</p>` : null}
      ${effect.redundant_with.length ? html`<p class="quiet">Cannot be told apart from: ${effect.redundant_with.map(words).join(", ")}.</p>` : null}
      <label>On the shaft of <select value=${shaft.value} onChange=${(/** @type {Event} */ e) => { shaft.value = written(e); redraw(); }}>
        <option value="" selected=${!shaft.value}>the experiment of the paper</option>${sources().map((s) => html`<option value=${s.key} selected=${s.key === shaft.value}>${s.name}</option>`)}</select></label>
      <div class="sliders">${effect.parameters.map((p) => {
        const on = scale(p);
        const value = values.value[p.name];
        return html`<label>${p.words}: ${significant(value)} ${p.unit === "1" ? "" : p.unit}
          <input type="range" min="0" max="100" step="0.5" value=${on.place(value)} aria-valuetext=${`${significant(value)} ${p.unit}`}
            onInput=${(/** @type {Event} */ e) => { values.value = { ...values.value, [p.name]: on.value(Number(written(e))) }; redraw(); }} />
          <span>${significant(on.low)} to ${significant(on.high)}, typical ${significant(p.typical)}${p.shapes ? ", shape only" : ""}</span></label>`;
      })}</div></section>
      ${lesson.value ? html`<${Trial} found=${lesson.value} />` : null}</div>` : null}</div>`;
}

const COMPARED = [line("null model", "--quiet"), line("with the effect", "--model")];

/** @param {{found: import("./types").LessonDocument}} props */
function Trial({ found }) {
  const starts = found.phases.map((p, k) => ({ ...p, end_s: found.phases[k + 1]?.start_s ?? found.time_s.at(-1) }));
  return html`<section class="card"><h2>Change against the null model, in units of the noise</h2>
    <p class="quiet">A compensation to 45° on ${found.shaft}; noise ${significant(found.channels[0].noise)} N·mm and ${significant(found.channels[1].noise)}°.</p>
    <div class="scroll" tabindex="0" role="group" aria-label="Change by channel"><table><thead><tr><th scope="col">channel</th><th scope="col">root mean square / noise</th><th scope="col">peak / noise</th></tr></thead>
      <tbody>${found.channels.map((c) => html`<tr><th scope="row">${words(c.name)}</th><td>${number(c.rms_sigmas, 1)}</td><td>${number(c.most_sigmas, 1)}</td></tr>`)}</tbody></table></div>
    <${Legend} series=${found.channels.map((c, k) => line(words(c.name), `--c${k}`))} />
    <${Plot} name="change" label="Change against the null model by channel" unit="change / noise" height=${200} cursor="learn" marks=${starts}
      series=${found.channels.map((c, k) => line(words(c.name), `--c${k}`))} data=${[found.time_s, ...found.channels.map((c) => c.sigmas)]} />
    <${Legend} series=${COMPARED} />
    <div class="grid2">${found.channels.map((c) => html`<div><h3>${words(c.name)}</h3>
      <${Plot} name=${c.name} label=${`${c.name} with and without the effect`} unit=${`${words(c.name)} / ${c.unit}`} height=${170} cursor="learn" marks=${starts}
        series=${COMPARED} data=${[found.time_s, c.null, c.effect]} /></div>`)}</div></section>`;
}
