// What every page module builds with: templates, state, and words that several pages use.
import { h } from "./vendor/preact.js";
import htm from "./vendor/htm.js";

export { render } from "./vendor/preact.js";
export { useEffect, useRef } from "./vendor/hooks.js";
export { signal, computed, effect, batch, untracked, useSignal } from "./vendor/signals.js";

export const html = htm.bind(h);

/** Headings of a table of numbers. A narrow page has a card for each row, whose values have their names beside them (`Cells`).
 * @param {{of: string, names: string[]}} props */
export const Heads = ({ of, names }) => html`<thead><tr><th scope="col">${of}</th>${names.map((name) => html`<th scope="col">${name}</th>`)}</tr></thead>`;
/** Cells of a row, each with its heading. @param {{names: string[], values: string[]}} props */
export const Cells = ({ names, values }) => names.map((name, k) => html`<td data-label=${name}>${values[k]}</td>`);

/** A number with a fixed count of decimals, or a dash where there is none.
 * @param {number | string | null | undefined} value @param {number} decimals */
export const number = (value, decimals) =>
  typeof value !== "number" || !Number.isFinite(value)
    ? "–"
    : value.toFixed(decimals).replace(/^-(0(\.0*)?)$/, "$1").replace("-", "−");

/** A number with three significant digits.
 * @param {number | string | null | undefined} value */
export const significant = (value) => {
  if (typeof value !== "number" || !Number.isFinite(value)) return "–";
  return String(Number(value.toPrecision(3))).replace("-", "−");
};

/** A value with its standard deviation, of which two digits are told, and as many decimals of the value.
 * @param {number} value @param {number | null | undefined} uncertainty */
export const measured = (value, uncertainty) => {
  if (!uncertainty || !Number.isFinite(uncertainty)) return significant(value);
  const decimals = Math.min(Math.max(1 - Math.floor(Math.log10(uncertainty)), 0), 12);
  return `${number(value, decimals)} ± ${number(uncertainty, decimals)}`;
};

/** A distance in standard deviations; beyond 8 of them a figure says no more. Its sign stands before it, or in words behind.
 * @param {number} sigmas @param {string} [more] @param {string} [less] */
export const distance = (sigmas, more = "", less = "") => {
  const far = Math.abs(sigmas) > FARTHEST_SIGMAS;
  const told = `${more ? "" : sigmas < 0 ? "−" : "+"}${far ? FARTHEST_SIGMAS : number(Math.abs(sigmas), 1)} σ`;
  return `${far ? (more ? "more than " : "beyond ") : ""}${told}${more && ` ${sigmas < 0 ? less : more}`}`;
};
/** As `FARTHEST_SIGMAS` of the program's own sentences. */
const FARTHEST_SIGMAS = 8;

/** A docstring as people read it: without marks of code. @param {string} text */
export const prose = (text) => text.replaceAll("`", "");

/** A docstring with the index of a symbol below the line. @param {string} text */
export const typeset = (text) => prose(text).split(/([θτ]_[a-z]+|\bl_[a-z]+)/).map((part, k) => (k % 2 ? html`${part[0]}<sub>${part.slice(2)}</sub>` : part));

/** A sentence of the program as a page begins it. @param {string} text */
export const sentence = (text) => text.charAt(0).toUpperCase() + text.slice(1);

/** A command of a terminal, or an option of one; `web` and `daemon` start what no page can start. */
const COMMAND = /(?:^|[:(`] ?|\bwith )needle-rig (?!web\b|daemon\b)[a-z]|(?:^|[ (])--[a-z]|^option [a-z_]+$/;
/** Up to the clause that gives a command. @param {string} text */
function clausesBefore(text) {
  const at = text.search(COMMAND);
  if (at < 0) return text;
  const told = text.slice(0, at + 1).replace(/[;:,][^;:,]*$/, "");
  return told.length > at ? "" : told.replace(/[;,][^;,]* with$/, "");
}
/** A sentence of the program as the page tells it: without what a terminal would do next, for which it has buttons. @param {string} text */
export const plain = (text) => text.split(" Also: ").map((part) => {
  const named = part.replace(/`needle-rig ([a-z]+)`/g, "$1").replace(/then: needle-rig ([a-z]+)$/, "then $1");
  return clausesBefore(named.replace(/ \(([^()]*)\)/g, (_, inner) => (clausesBefore(inner) ? ` (${clausesBefore(inner)})` : ""))) || part;
}).join(" Also: ");

/** What stands in the field of this event. @param {Event} event */
export const written = (event) => /** @type {HTMLInputElement} */ (event.target).value;
/** Whether its box is ticked. @param {Event} event */
export const ticked = (event) => /** @type {HTMLInputElement} */ (event.target).checked;

/** A name of the program as people read it.
 * @param {string} name */
export const words = (name) => name.replaceAll("_", " ");

/** A parameter as people read it: its unit, which ends its name, stands beside its value.
 * @param {string} name */
export const parameter = (name) =>
  words(name.replace(/_(nmms?_per_rad(_per_100mm)?|nmm_per_100mm|nmm_per_min|nmm2|nmm|deg_s|deg|mm|m?s)(?=\[|$)/, ""))
    .replace(".", ": ").replace(/\[(\d+)\]/, (_, k) => ` ${Number(k) + 1}`);
