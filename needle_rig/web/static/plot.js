// Traces over time: uPlot with the page's colours, units on every axis, and bands of noise.
import uPlot from "./vendor/uplot.js";
import { html, signal, useEffect, useRef } from "./ui.js";

/** A colour of the style sheet. @param {string} name */
export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** @param {string} label @param {number} size across, px */
export function axis(label, size) {
  return {
    label,
    labelSize: 16,
    labelFont: "12px system-ui",
    font: "11px system-ui",
    size,
    stroke: () => colour("--quiet"),
    grid: { stroke: () => colour("--line"), width: 1 },
    ticks: { stroke: () => colour("--line"), width: 1, size: 4 },
  };
}

/** A line of the plot.
 * @param {string} label @param {string} name of its colour @param {object} [more] */
export const line = (label, name, more = {}) => ({
  label,
  stroke: () => colour(name),
  width: 1.5,
  points: { show: false },
  ...more,
});

/** Dots without a line. @param {string} label @param {string} name */
export const dots = (label, name) => ({
  label,
  stroke: () => colour(name),
  paths: () => null,
  points: { show: true, size: 2.5, width: 0, fill: () => colour(name) },
});

const scheme = matchMedia("(prefers-color-scheme: dark)");
/** A legend keeps the colours that it was made with: every plot is made anew when the scheme changes. */
const dark = signal(scheme.matches);
scheme.addEventListener("change", () => (dark.value = scheme.matches));

/** A plot that keeps its instance while only data and marked times change.
 * @param {{label: string, series: any[], unit: string, data: any[], height: number, band?: boolean,
 *   marks?: {start_s: number, end_s?: number, name?: string}[], range?: [number, number] | null, cursor?: string,
 *   time?: string, least?: number}} props `least` is the smallest height of the drawn range, in the unit of the plot */
export function Plot({ label, series, unit, data, height, marks, range, band, cursor, time = "time / s", least = 0 }) {
  const place = useRef(/** @type {HTMLElement | null} */ (null));
  const plot = useRef(/** @type {any} */ (null));
  const latest = useRef({ marks, range });
  latest.current = { marks, range };
  const shape = JSON.stringify([series.map((s) => s.label), unit, height, band, dark.value]);
  useEffect(() => {
    const holder = /** @type {HTMLElement} */ (place.current);
    const made = new uPlot(
      {
        width: Math.max(holder.clientWidth, 200),
        height,
        series: [{ label: time }, ...series],
        axes: [axis(time, 26), axis(unit, 48)],
        scales: { x: { time: false, range: (/** @type {any} */ _u, /** @type {number} */ low, /** @type {number} */ high) => latest.current.range ?? [low, high] },
          y: {
            range: (/** @type {any} */ _u, /** @type {number | null} */ low, /** @type {number | null} */ high) => {
              const [a, b] = [low ?? 0, high ?? 1];
              const room = Math.max(0.06 * (b - a), (least - (b - a)) / 2, 1e-9);
              return [a - room, b + room];
            },
          },
        },
        bands: band ? [{ series: [3, 4], fill: () => colour("--band") }] : [],
        legend: { show: true, live: false },
        cursor: { drag: { x: true, y: false }, ...(cursor ? { sync: { key: cursor } } : {}) },
        hooks: {
          drawClear: [
            (/** @type {any} */ u) => {
              const { ctx } = u;
              for (const [k, mark] of (latest.current.marks ?? []).entries()) {
                const from = u.valToPos(mark.start_s, "x", true);
                const to = u.valToPos(mark.end_s ?? mark.start_s, "x", true);
                if (k % 2 === 0 && to > from) {
                  ctx.fillStyle = colour("--shade");
                  ctx.fillRect(from, u.bbox.top, to - from, u.bbox.height);
                }
              }
            },
          ],
        },
      },
      data,
      holder,
    );
    plot.current = made;
    const sized = new ResizeObserver(() => made.setSize({ width: Math.max(holder.clientWidth, 200), height }));
    sized.observe(holder);
    return () => {
      sized.disconnect();
      made.destroy();
    };
  }, [shape]);
  useEffect(() => plot.current?.setData(data), [data, range?.[0], range?.[1]]);
  return html`<div class="plot" role="img" aria-label=${label} ref=${place}></div>`;
}
