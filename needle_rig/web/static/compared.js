// A model held against data: errors by channel and values, as they stand and refitted; what is held; figures.
import { picture, save } from "./net.js";
import { distance, html, number, parameter, sentence, signal, ticked, words, written as field } from "./ui.js";

/** @typedef {import("./types").CompareResult} Found */
/** A number of a document: infinity is a text. @typedef {number | string | null} Told */

/** Distance of a value above which it is marked, and the limit of the residual map. */
const MARKED_SIGMAS = 3;

/** What the next comparison holds. @typedef {{refit: boolean, fixed: Record<string, number>, free: string[]}} Held */
/** @type {{value: Held}} */
export const held = signal({ refit: false, fixed: {}, free: [] });
/** What stands in the form and was not asked yet, by value. @type {{value: Record<string, string>}} */
const written = signal({});

/** The form of a comparison: what it held. @param {Partial<Held>} asked */
export function holdAs({ refit = false, fixed = {}, free = [] }) {
  held.value = { refit, fixed, free };
  written.value = {};
}

/** A number of a document, where infinity is a text. @param {number | string | null} value */
const told = (value) => (value === null ? "–" : typeof value === "string" ? value.replace("inf", "∞").replace("-", "−") : String(Number(value.toPrecision(6))).replace("-", "−"));

/** A value and its standard deviation, to the second digit of the latter; it breaks before ± alone.
 * @param {{value: number | string | null, uncertainty: number | string | null}} props */
function Measured({ value, uncertainty }) {
  if (typeof value !== "number" || typeof uncertainty !== "number" || !(uncertainty > 0)) return html`<span>${told(value)}</span>`;
  const decimals = Math.min(Math.max(1 - Math.floor(Math.log10(uncertainty)), 0), 9);
  return html`<span>${number(value, decimals)}</span> <span>± ${number(uncertainty, decimals)}</span>`;
}

/** A distance in standard deviations. @param {{sigmas: number | string | null | undefined}} props */
function Apart({ sigmas }) {
  if (sigmas === null || sigmas === undefined) return html`<td>–</td>`;
  const far = typeof sigmas === "string" || Math.abs(sigmas) > MARKED_SIGMAS;
  const text = typeof sigmas === "string" ? `${told(sigmas)} σ` : distance(sigmas);
  return html`<td class=${far ? "doubt" : ""}>${far ? html`<strong>${text}</strong>` : text}</td>`;
}

/** Each value of the model beside that of a refit. @param {{found: Found}} props */
export function Values({ found }) {
  const own = found.parameters.some((p) => p.model !== null);
  const pulled = found.parameters.some((p) => p.pull_sigma !== null && p.pull_sigma !== undefined);
  return html`<h3>Values${own ? ": as the model says, and refitted" : ", fitted"}</h3>
    ${found.verdict_on_values ? html`<p><strong>${sentence(found.verdict_on_values)}</strong></p>` : null}
    <div class="scroll" tabindex="0" role="group" aria-label="Values"><table class="values"><thead><tr><th class="text" scope="col">value</th>
      ${own ? html`<th scope="col">the model says</th>` : null}<th scope="col">${own ? "a refit wants" : "fitted"}</th>${own ? html`<th scope="col">apart</th>` : null}
      ${pulled ? html`<th scope="col">from what is stated</th>` : null}</tr></thead>
      <tbody>${found.parameters.map((p) => html`<tr><th scope="row">${parameter(p.name)}${p.unit === "1" ? null : html` <span class="quiet">/ ${p.unit}</span>`}</th>
        ${own ? html`<td><${Measured} value=${p.model} uncertainty=${p.model_uncertainty} /></td>` : null}
        <td>${p.fixed ? html`${told(p.refit)} <span class="quiet">fixed</span>` : html`<${Measured} value=${p.refit} uncertainty=${p.refit_uncertainty} />`}</td>
        ${own ? html`<${Apart} sigmas=${p.sigmas} />` : null}${pulled ? html`<${Apart} sigmas=${p.pull_sigma} />` : null}</tr>`)}</tbody></table></div>
    ${found.own.map((/** @type {string} */ s) => html`<p class="quiet">${sentence(s)}.</p>`)}`;
}

/** The table by channel, or by reported value; a narrow page leaves the noise out, which the ratio tells.
 * @param {{found: Found}} props */
export function Errors({ found }) {
  const side = found.headings.map((/** @type {string} */ name, /** @type {number} */ k) => (k === 0 ? "text" : name === "noise" ? "where-wide" : ""));
  return html`<div class="scroll" tabindex="0" role="group" aria-label="Errors"><table class="values"><thead><tr>${found.headings.map((/** @type {string} */ name, /** @type {number} */ k) =>
      html`<th scope="col" class=${side[k]}>${name}</th>`)}</tr></thead>
    <tbody>${found.rows.map((/** @type {string[]} */ row) => html`<tr><th scope="row">${words(row[0])}</th>${row.slice(1).map((cell, k) => html`<td class=${side[k + 1]}>${cell}</td>`)}</tr>`)}</tbody></table></div>`;
}

/** Which values the comparison holds, fixes and fits. @param {{found: Found, own: boolean, busy: boolean, again: () => void}} props */
export function More({ found, own, busy, again }) {
  const { refit, fixed, free } = held.value;
  /** @param {string} name */
  const how = (name) => (name in written.value || name in fixed ? "fixed" : free.includes(name) ? "free" : "");
  /** @param {string} name @param {string} choice @param {string} value */
  const choose = (name, choice, value) => {
    const { [name]: _, ...others } = fixed;
    const { [name]: __, ...texts } = written.value;
    held.value = { refit, fixed: others, free: free.filter((f) => f !== name).concat(choice === "free" ? [name] : []) };
    written.value = choice === "fixed" ? { ...texts, [name]: value } : texts;
  };
  const ask = (/** @type {Event} */ event) => {
    event.preventDefault();
    const numbers = Object.entries(written.value).map(([name, text]) => [name, Number(text.replace(",", "."))]);
    held.value = { ...held.value, fixed: { ...fixed, ...Object.fromEntries(numbers) } };
    written.value = {};
    again();
  };
  return html`<details class="more"><summary>More: hold, fix or free values</summary>
    <form onSubmit=${ask}>
    ${own ? html`<p><label class="row"><input type="checkbox" checked=${refit} onChange=${(/** @type {Event} */ e) => (held.value = { refit: ticked(e), fixed, free: [] })} /> only the refit, nothing as it stands</label></p>` : null}
    ${found.traces ? html`<ul class="plain">${found.parameters.map((p) => html`<li><label class="row">${parameter(p.name)}${p.unit === "1" ? "" : ` / ${p.unit}`}
        <select value=${how(p.name)} onChange=${(/** @type {Event} */ e) => choose(p.name, field(e), told(p.model ?? p.refit).replace("−", "-"))}>
          <option value="">${own && !refit ? "as the model says" : "fitted"}</option><option value="fixed">fixed at</option>${own && !refit ? html`<option value="free">free: fitted in both columns</option>` : null}</select></label>
        ${how(p.name) === "fixed" ? html` <input class="short" inputmode="decimal" required pattern="[-+]?[0-9]*[.,]?[0-9]+([eE][-+]?[0-9]+)?" aria-label=${`${parameter(p.name)} fixed at`} value=${written.value[p.name] ?? told(fixed[p.name]).replace("−", "-")}
          onInput=${(/** @type {Event} */ e) => (written.value = { ...written.value, [p.name]: field(e) })} />` : null}</li>`)}</ul>` : null}
    <p><button disabled=${busy}>Compare again</button></p></form></details>`;
}

/** Names of the figures and how a person calls them, in the order in which they are offered. */
const FIGURES = /** @type {const} */ ({
  loop: "torque against angle",
  strips: "residual strips",
  over_time: "residuals over time",
  over_model: "residuals over the model's value",
  qq: "Q–Q",
  autocorrelation: "autocorrelation",
  pulls: "pulls",
  correlation: "correlation of values",
  profile: "profile of values",
  band: "prediction band",
  traces: "traces",
  residuals: "residual map",
});
/** Wider than two columns of a journal: scrolled on a phone. */
const WIDE_PX = 600;

/** Drawn figures of the present comparison by name. @type {{value: Record<string, {key: string, words: string, url: string, files: Record<string, string>}>}} */
const drawn = signal({});
const shown = signal("");
const wide = signal(false);

/** Forget the figures of a comparison that is no more. */
export function forgetFigures() {
  for (const { url } of Object.values(drawn.value)) URL.revokeObjectURL(url);
  drawn.value = {};
  shown.value = "";
}

/** Every figure of the comparison, drawn when it is asked for.
 * @param {{busy: boolean, draw: (what: string) => Promise<{key: string, words: string, files: Record<string, string>} | null>, refuse: (error: Error) => void}} props */
export function Figures({ busy, draw, refuse }) {
  /** @param {string} what */
  const show = async (what) => {
    if (!drawn.value[what]) {
      const found = await draw(what);
      if (!found) return;
      try {
        drawn.value = { ...drawn.value, [what]: { ...found, url: await picture(`jobs/${found.key}/${found.files.svg}`) } };
      } catch (error) {
        return refuse(/** @type {Error} */ (error));
      }
    }
    shown.value = what;
  };
  const now = drawn.value[shown.value];
  return html`<section class="card wide"><h2>Figures</h2>
    <div class="tabs" role="group" aria-label="Figures">${Object.entries(FIGURES).map(([what, name]) => html`<button aria-pressed=${shown.value === what} disabled=${busy && !drawn.value[what]}
      onClick=${() => show(what)}>${name}</button>`)}</div>
    ${now ? html`<figure><div class="paper" tabindex="0" role="group" aria-label="The figure"><img src=${now.url} alt=${now.words} class=${wide.value ? "large" : ""}
        onLoad=${(/** @type {Event} */ e) => (wide.value = /** @type {HTMLImageElement} */ (e.target).naturalWidth > WIDE_PX)} /></div><figcaption class="quiet">${now.words}</figcaption></figure>
      <p>Save as ${Object.entries(now.files).map(([kind, file]) => html`<button onClick=${() => save(`jobs/${now.key}/${file}`, file).catch(refuse)}>${kind.toUpperCase()}</button> `)}</p>`
      : html`<p class="quiet">${busy ? "Working …" : "Each is drawn when it is asked for, in some seconds."}</p>`}</section>`;
}
