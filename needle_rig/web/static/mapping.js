// What is what in dropped recordings: the proposed mapping, line by line, to confirm or correct.
import { Plot, line } from "./plot.js";
import { effect, html, sentence, signal, significant, untracked, words, written } from "./ui.js";

/** @typedef {import("./types").Mapping} Mapping */
/** @typedef {import("./types").GuessResult & {key: string}} Guess */
/** @typedef {Guess & {upload: string}} Proposal */
/** The dropped recordings and their mapping. @type {{value: Proposal | null}} */
export const proposal = signal(null);
/** Doubts that a person has looked at, by line. @type {{value: string[]}} */
const confirmed = signal([]);
const layoutOf = signal("");
const layoutText = signal("");

const LAYOUT = `needle: {diameter_mm: 0.39, shear_modulus_gpa: 27.2, density_g_cm3: 6.45}
needle_length_mm: 397
tissue_sections_mm: [[175, 200], [240, 265]]
hall_sensors:
  - {name: hall_1, position_mm: 220}
`;
const KEPT = "needle-rig-mapping-";
const NOT_USED = "not used";
const WRITTEN = "written here";
const MACHINE = "machine:";

/** Take in what is proposed for an upload. @param {string} upload @param {Guess} found */
export function propose(upload, found) {
  if (untracked(() => proposal.value)?.key === found.key) return;
  const kept = JSON.parse(sessionStorage.getItem(`${KEPT}${found.key}`) ?? "null");
  proposal.value = { ...found, upload, mapping: kept?.mapping ?? found.mapping };
  confirmed.value = kept?.confirmed ?? [];
}
effect(() => {
  // what a person corrected outlives a reload of this tab
  const { key, mapping } = proposal.value ?? {};
  if (key) sessionStorage.setItem(`${KEPT}${key}`, JSON.stringify({ mapping, confirmed: confirmed.value }));
});

/** Where the shaft of a guess is taken from, as the server wants it. */
export const shaft = () =>
  layoutOf.value === WRITTEN ? { layout: layoutText.value }
  : layoutOf.value.startsWith(MACHINE) ? { machine: layoutOf.value.slice(MACHINE.length) }
  : layoutOf.value ? { layout_of: layoutOf.value } : {};

/** The mapping as the page shows it: confirmed doubts are part of the reasons, unused lines are left out. */
/** @param {Mapping} mapping */
export function asConfirmed(mapping) {
  /** @template {import("./types").LayoutPart} P @param {P} part @param {string} key @returns {P} */
  const taken = (part, key) =>
    part.doubt && confirmed.value.includes(key)
      ? { ...part, doubt: "", why: [part.why, `confirmed: ${part.doubt}`].filter(Boolean).join("; ") }
      : part;
  const used = mapping.channels.filter((c) => c.role !== NOT_USED);
  return {
    ...mapping,
    clocks: Object.fromEntries(Object.entries(mapping.clocks).map(([name, c]) => [name, taken(c, `clock ${name}`)])),
    channels: used.map((c) => taken(c, `channel ${c.clock} ${c.source}`)),
    trials: taken(mapping.trials, "trials"),
    layout: taken(mapping.layout, "layout"),
    not_used: [...mapping.not_used, ...mapping.channels.filter((c) => c.role === NOT_USED).map((c) => ({ source: c.source, clock: c.clock, why: "left aside by hand" }))],
  };
}

/** @param {(mapping: Mapping) => Mapping} change */
function edit(change) {
  if (proposal.value) proposal.value = { ...proposal.value, mapping: change(proposal.value.mapping) };
}

/** @param {number} k @param {object} more */
const channel = (k, more) => edit((mapping) => ({ ...mapping, channels: mapping.channels.map((c, i) => (i === k ? { ...c, ...more } : c)) }));
/** @param {string} name @param {object} more */
const clock = (name, more) => edit((mapping) => ({ ...mapping, clocks: { ...mapping.clocks, [name]: { ...mapping.clocks[name], ...more } } }));

/** What a mapping file calls by its keys, as the page calls it. @param {string} text */
const onPage = (text) => words(text.replace(/; write (?:it as )?`unit`, (?:as (\w+), with|and) `scale` where .*$/, (_, as) => `; write a known one beside it${as ? `, such as ${as}` : ""}`)
  .replace(/^(\w+) \(([^)]*)\)/, (_, role, source) => `${source}, taken as ${role}`).replaceAll("`", ""));

/** A doubt with its tick. @param {{part: import("./types").LayoutPart, of: string}} props */
function Doubt({ part, of }) {
  if (!part.doubt) return null;
  const is = confirmed.value.includes(of);
  return html`<label class="row doubt"><input type="checkbox" checked=${is}
    onChange=${() => (confirmed.value = is ? confirmed.value.filter((o) => o !== of) : [...confirmed.value, of])} /> <span>confirm anyway: ${onPage(part.doubt)}</span></label>`;
}

/** The mapping of dropped recordings; `again` asks for another guess, `take` imports, `discard` removes what was dropped.
 * @param {{busy: boolean, sources: import("./types").Named[], machines: import("./types").Named[], again: () => void, take: () => void, discard: () => void}} props */
export function WhatIsWhat({ busy, sources, machines, again, take, discard }) {
  const found = proposal.value;
  if (!found) return null;
  const { mapping } = found;
  const value = written;
  return html`<section class="card wide" aria-label="What is what"><h2>1 · Data: assign the columns of ${mapping.name}</h2>
    <p>Proposed from names, units and what the channels do. Correct what is wrong; confirm what is in doubt.</p>
    <div class="scroll" tabindex="0" role="group" aria-label="Channels"><table class="stacked"><thead><tr><th class="text">column</th><th class="text">is</th><th class="text">unit</th><th class="text">sign</th><th class="text">zero</th><th class="text">why</th></tr></thead>
      <tbody>${mapping.channels.map((c, k) => html`<tr><th scope="row" class="text">${c.source}</th>
        <td data-label="is"><select aria-label=${`${c.source} is`} value=${c.role} onChange=${(/** @type {Event} */ e) => channel(k, { role: value(e) })}>
          ${[...new Set([...found.roles, c.role, NOT_USED])].map((role) => html`<option value=${role} selected=${role === c.role}>${words(role)}</option>`)}</select></td>
        <td data-label="unit"><input class="short" aria-label=${`Unit of ${c.source}`} value=${c.unit ?? ""} onChange=${(/** @type {Event} */ e) => channel(k, { unit: value(e) || null })} /></td>
        <td data-label="sign"><select aria-label=${`Sign of ${c.source}`} onChange=${(/** @type {Event} */ e) => channel(k, { sign: Number(value(e)) })}>
          <option value="1" selected=${c.sign > 0}>+</option><option value="-1" selected=${c.sign < 0}>−</option></select></td>
        <td data-label="zero"><select aria-label=${`Zero of ${c.source}`} onChange=${(/** @type {Event} */ e) => channel(k, { zero: value(e) === "start" ? "start" : Number(value(e)) })}>
          <option value="start" selected=${c.zero === "start"}>at the start</option><option value=${c.zero === "start" ? 0 : c.zero} selected=${c.zero !== "start"}>${c.zero === "start" ? 0 : significant(c.zero)}</option></select></td>
        <td class="text">${c.why}<${Doubt} part=${c} of=${`channel ${c.clock} ${c.source}`} /></td></tr>`)}</tbody></table></div>
    <h3>Clocks and trials</h3>
    <ul class="plain">${Object.entries(mapping.clocks).map(([name, c]) => html`<li>${name}: ${c.source === null ? "a rate" : `column ${c.source}`}${" "}
      ${c.source === null ? html`<label class="row">samples a second <input class="short" value=${c.rate_hz ?? ""} onChange=${(/** @type {Event} */ e) => clock(name, { rate_hz: Number(value(e)) || null })} /></label>`
        : html`<label class="row">unit <input class="short" value=${c.unit ?? ""} onChange=${(/** @type {Event} */ e) => clock(name, { unit: value(e) || null })} /></label>`}
      ${" "}<span class="quiet">${c.why}</span><${Doubt} part=${c} of=${`clock ${name}`} /></li>`)}
      <li>trials: ${{ whole: "each recording is one", rests: "cut where the base rests", column: `cut where ${mapping.trials.source} changes`, times: "cut at times" }[/** @type {"whole"} */ (mapping.trials.at)]},
        ${" "}<label class="row">the shaft begins <select value=${mapping.trials.start} onChange=${(/** @type {Event} */ e) => edit((m) => ({ ...m, trials: { ...m.trials, start: value(e) === "wound" ? "wound" : "relaxed" } }))}>
          ${["relaxed", "wound"].map((start) => html`<option value=${start} selected=${start === mapping.trials.start}>${start}</option>`)}</select></label>
        ${" "}<span class="quiet">${mapping.trials.why}</span><${Doubt} part=${mapping.trials} of="trials" /></li>
      ${mapping.not_used.map((n) => html`<li class="quiet">not used: ${n.source} (${n.why})</li>`)}</ul>
    <h3>The shaft</h3>
    <div class="orders"><label>looks like that of <select value=${layoutOf.value} onChange=${(/** @type {Event} */ e) => { layoutOf.value = value(e); if (value(e) === WRITTEN && !layoutText.value) layoutText.value = LAYOUT; }}>
        <option value="" selected=${!layoutOf.value}>${mapping.rig ? "what was dropped" : "choose"}</option><option value=${WRITTEN} selected=${layoutOf.value === WRITTEN}>${WRITTEN}</option>
        ${machines.map((m) => html`<option value=${MACHINE + m.key} title=${m.name} selected=${MACHINE + m.key === layoutOf.value}>${m.key}</option>`)}
        ${sources.map((s) => html`<option value=${s.key} selected=${s.key === layoutOf.value}>${s.name}</option>`)}</select></label>
      <button disabled=${busy || !layoutOf.value} onClick=${again}>Propose again with this shaft</button></div>
    ${layoutOf.value === WRITTEN ? html`<label class="all">The shaft in lines of YAML<textarea rows="8" value=${layoutText.value} onInput=${(/** @type {Event} */ e) => (layoutText.value = value(e))}></textarea></label>` : null}
    ${mapping.layout.why ? html`<p class="quiet">${sentence(words(mapping.layout.why))}.</p>` : null}<${Doubt} part=${mapping.layout} of="layout" />
    ${mapping.rig && (mapping.rig.lever_mm || found.lacks.some((/** @type {string} */ s) => s.startsWith("rig.lever_mm"))) ? html`<label class="row">lever of what slides, in mm <input class="short" value=${mapping.rig.lever_mm ?? ""} onChange=${(/** @type {Event} */ e) => edit((m) => ({ ...m, rig: m.rig && { ...m.rig, lever_mm: Number(value(e)) || null } }))} /></label>` : null}
    ${found.lacks.length ? html`<ul class="lacks">${found.lacks.map((/** @type {string} */ s) => html`<li>${onPage(s)}</li>`)}</ul>` : null}
    <p class="buttons"><button class="go" disabled=${busy || !mapping.rig} onClick=${take}>Import</button>
      <button disabled=${busy} onClick=${discard}>Discard</button>${mapping.rig ? null : html` <span class="lacks">Choose a shaft above, or describe one, before importing.</span>`}</p>
    <div class="grid2">${found.shown.map((s) => html`<div><h3>${words(s.role)} <span class="quiet">${s.source}</span></h3>
      <${Plot} name=${s.role} label=${`${s.role} from ${s.source} over time`} unit=${s.unit === "?" ? `${words(s.role)}, no unit` : `${words(s.role)} / ${s.unit}`} height=${160} cursor="mapping" series=${[line(words(s.role), "--c1")]} data=${[s.time_s, s.values]} /></div>`)}</div></section>`;
}
