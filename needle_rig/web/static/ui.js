// What every page module builds with: templates, state, and words that several pages use.
import { h } from "./vendor/preact.js";
import htm from "./vendor/htm.js";

export { render } from "./vendor/preact.js";
export { useEffect, useRef } from "./vendor/hooks.js";
export { signal, computed, effect, batch, useSignal } from "./vendor/signals.js";

export const html = htm.bind(h);

/** A number with a fixed count of decimals, or a dash where there is none.
 * @param {number | null | undefined} value @param {number} decimals */
export const number = (value, decimals) =>
  value === null || value === undefined || !Number.isFinite(value)
    ? "–"
    : value.toFixed(decimals).replace(/^-(0(\.0*)?)$/, "$1").replace("-", "−");

/** A number with three significant digits.
 * @param {number | null | undefined} value */
export const significant = (value) => {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  return String(Number(value.toPrecision(3))).replace("-", "−");
};

/** A name of the program as people read it.
 * @param {string} name */
export const words = (name) => name.replaceAll("_", " ");

/** Channels in a fixed order have a fixed colour, of Okabe and Ito's palette.
 * @param {number} index 0 is the torque */
export const channelClass = (index) => `c${Math.min(index, 8)}`;
