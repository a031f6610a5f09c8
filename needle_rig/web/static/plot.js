// Charts: uPlot with the page's colours, units on every axis, bands, what a person points at, linked zoom, and ways to save.
import uPlot from "./vendor/uplot.js";
import { Save } from "./saved.js";
import { html, number, signal, useEffect, useRef, words } from "./ui.js";

/** @typedef {import("./vendor/uplot.js").Series} Series */
/** @typedef {import("./vendor/uplot.js").Values} Values */
/** A line or dots, with the name of their colour. @typedef {Series & {label: string, colour: string, look: "line" | "dots" | "dashed" | "edge"}} Drawn */
/** @typedef {{start_s: number, end_s?: number, name?: string}} Mark */

/** A colour of the style sheet. @param {string} name */
export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** Between the ticks of an axis, px. */
const SPACE = 30;
/** The same in a chart so low that it would have one tick. */
const CLOSE = 16;
const LOW = 150;
/** Steps of an axis that counts. */
const COUNTS = [1, 2, 5].flatMap((k) => [0, 1, 2, 3, 4].map((d) => k * 10 ** d)).sort((a, b) => a - b);

/** Beside the numbers of an axis, and for each letter of theirs, px. */
const BESIDE = 24;
const LETTER = 6.5;
/** So much room as the longest number wants, and never less than `least`, so that charts stand below each other.
 * @param {number} least */
const room = (least) => (/** @type {uPlot} */ _u, /** @type {string[] | null} */ values) => Math.max(least, BESIDE + LETTER * Math.max(0, ...(values ?? []).map((text) => text.length)));

/** @param {string} label @param {number | ReturnType<typeof room>} size across, px @param {object} [more] */
export function axis(label, size, more = {}) {
  return {
    label,
    labelSize: 16,
    labelFont: "12px system-ui",
    font: "11px system-ui",
    size,
    // one minus sign on the whole page
    values: (/** @type {uPlot} */ _u, /** @type {number[]} */ splits) => {
      const step = splits.length > 1 ? Math.abs(splits[1] - splits[0]) : 1;
      let decimals = 0;
      while (decimals < 9 && Math.abs(step * 10 ** decimals - Math.round(step * 10 ** decimals)) > 1e-6) decimals += 1;
      return splits.map((value) => number(value, decimals));
    },
    stroke: () => colour("--quiet"),
    grid: { stroke: () => colour("--line"), width: 1 },
    ticks: { stroke: () => colour("--line"), width: 1, size: 4 },
    ...more,
  };
}

/** A line of the plot.
 * @param {string} label @param {string} name of its colour @param {{dash?: number[], width?: number}} [more] @returns {Drawn} */
export const line = (label, name, more = {}) => ({
  label, colour: name, look: more.dash ? "dashed" : "line",
  stroke: () => colour(name), width: 1.5, points: { show: false }, ...more,
});

/** Dots without a line. @param {string} label @param {string} name @returns {Drawn} */
export const dots = (label, name) => ({
  label, colour: name, look: "dots",
  stroke: () => colour(name), paths: () => null, points: { show: true, size: 2.5, width: 0, fill: () => colour(name) },
});

/** Both edges of a band; the legend names it once. @param {string} label @returns {Drawn[]} */
export const edges = (label) => ["upper", "lower"].map((side) => ({
  label: `${label}, ${side}`, colour: "--band", look: "edge", stroke: () => colour("--band"), width: 0.5, points: { show: false },
}));

/** What the lines of the charts below stand for, once for all of them. @param {{series: Drawn[], band?: string}} props */
export function Legend({ series, band }) {
  const told = series.filter((one, k) => one.look !== "edge" && series.findIndex((other) => other.label === one.label) === k);
  return html`<p class="key">${told.map((one) => html`<span class="pair"><span class=${`swatch ${one.look}`} style=${{ color: `var(${one.colour})` }}></span>${one.label}</span> `)}
    ${band ? html`<span class="pair"><span class="swatch band"></span>${band}</span>` : null}</p>`;
}

const scheme = matchMedia("(prefers-color-scheme: dark)");
/** Every plot is made anew when the scheme changes. */
const dark = signal(scheme.matches);
scheme.addEventListener("change", () => (dark.value = scheme.matches));

/** The stretch that a person chose, by group of charts. @type {{value: Record<string, [number, number]>}} */
const zooms = signal({});
/** @param {string} group @param {[number, number] | null} stretch */
export function zoom(group, stretch) {
  const { [group]: _, ...others } = zooms.value;
  zooms.value = stretch ? { ...others, [group]: stretch } : others;
}
let groups = 0;

/** Narrower, wider and along by keys. @param {KeyboardEvent} event @param {string} group @param {[number, number]} now */
function byKey(event, group, [low, high]) {
  const span = high - low;
  const middle = (low + high) / 2;
  /** @type {Record<string, [number, number] | null>} */
  const to = { "+": [middle - span / 3, middle + span / 3], "-": [middle - span * 0.75, middle + span * 0.75], ArrowLeft: [low - span / 5, high - span / 5], ArrowRight: [low + span / 5, high + span / 5], 0: null };
  if (!(event.key in to) || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  zoom(group, to[event.key]);
}

/** @param {Values} values @param {number} of the unit's step */
const decimalsOf = (values, of) => {
  const seen = values.filter((v) => v !== null);
  const span = Math.max(...seen.slice(0, 2000).map(Math.abs), of);
  return Math.min(Math.max(0, 3 - Math.floor(Math.log10(span || 1))), 5);
};

/** A chart that keeps its instance while only data and marked times change.
 * @param {{label: string, series: Drawn[], unit: string, data: Values[], height: number, bands?: [number, number][], level?: number,
 *   marks?: Mark[], range?: [number, number] | null, cursor?: string, time?: string, counts?: boolean, least?: number, name?: string}} props
 *   `bands` are pairs of series (from 1): upper and lower edge; `level` shades from −level to +level; `least` is the smallest
 *   height of the drawn range, in the unit of the plot; charts with the same `cursor` share pointer and zoom; one with a `name` can be saved under it; one that `counts` has whole numbers along */
export function Plot({ label, series, unit, data, height, marks, range, bands, level, cursor, time = "time / s", counts = false, least = 0, name }) {
  const place = useRef(/** @type {HTMLElement | null} */ (null));
  const said = useRef(/** @type {HTMLElement | null} */ (null));
  const plot = useRef(/** @type {uPlot | null} */ (null));
  const own = useRef("");
  if (!own.current) own.current = `own-${(groups += 1)}`;
  const group = cursor ?? own.current;
  const chosen = zooms.value[group] ?? null;
  const latest = useRef({ marks, range, chosen, series, data });
  latest.current = { marks, range, chosen, series, data };
  const shape = JSON.stringify([series.map((s) => [s.label, s.colour, s.look]), unit, height, bands, level, dark.value]);
  useEffect(() => {
    const holder = /** @type {HTMLElement} */ (place.current);
    const made = new uPlot(
      {
        width: Math.max(holder.clientWidth, 200),
        height,
        series: [{ label: time }, ...series],
        axes: [axis(time, 26, counts ? { incrs: COUNTS } : {}), axis(unit, room(56), { space: height < LOW ? CLOSE : SPACE })],
        scales: { x: { time: false, range: (/** @type {uPlot} */ _u, /** @type {number} */ low, /** @type {number} */ high) => latest.current.chosen ?? latest.current.range ?? [low, high] },
          y: {
            range: (/** @type {uPlot} */ _u, /** @type {number | null} */ low, /** @type {number | null} */ high) => {
              const [a, b] = [Math.min(low ?? 0, level ? -level : Infinity), Math.max(high ?? 1, level ?? -Infinity)];
              // values that are all the same have a scale, too
              const flat = b > a || least ? 0 : Math.abs(b) / 20 || 1;
              const spare = Math.max(0.06 * (b - a), (least - (b - a)) / 2, flat);
              return [a - spare, b + spare];
            },
          },
        },
        bands: (bands ?? []).map((pair) => ({ series: pair, fill: () => colour("--band") })),
        legend: { show: false },
        cursor: { drag: { x: true, y: false, setScale: false }, sync: { key: group }, bind: { dblclick: () => () => zoom(group, null) } },
        hooks: {
          setSelect: [(/** @type {uPlot} */ u) => {
            const { left, width } = u.select;
            if (width < 4) return;
            const stretch = /** @type {[number, number]} */ ([u.posToVal(left, "x"), u.posToVal(left + width, "x")]);
            u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
            zoom(group, stretch);
          }],
          setCursor: [(/** @type {uPlot} */ u) => {
            const at = u.cursor.idx;
            const now = latest.current;
            if (!said.current) return;
            said.current.textContent = at === null || at === undefined ? "" : [`${time.split(" / ")[0]} ${number(now.data[0][at], 2)}`,
              ...now.series.map((s, k) => (s.look === "edge" || now.data[k + 1]?.[at] === null ? "" : `${s.label} ${number(now.data[k + 1][at], decimalsOf(now.data[k + 1], 1e-4))}`)).filter(Boolean)].join(" · ");
          }],
          drawClear: [
            (/** @type {uPlot} */ u) => {
              const { ctx } = u;
              ctx.fillStyle = colour("--shade");
              for (const [k, mark] of (latest.current.marks ?? []).entries()) {
                const from = Math.max(u.valToPos(mark.start_s, "x", true), u.bbox.left);
                const to = Math.min(u.valToPos(mark.end_s ?? mark.start_s, "x", true), u.bbox.left + u.bbox.width);
                if (k % 2 === 0 && to > from) ctx.fillRect(from, u.bbox.top, to - from, u.bbox.height);
              }
              if (level) {
                ctx.fillStyle = colour("--band");
                const top = u.valToPos(level, "y", true);
                ctx.fillRect(u.bbox.left, top, u.bbox.width, u.valToPos(-level, "y", true) - top);
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
  useEffect(() => plot.current?.setData(data), [data, range?.[0], range?.[1], chosen?.[0], chosen?.[1]]);
  const keys = (/** @type {KeyboardEvent} */ event) => {
    const x = plot.current?.scales.x;
    if (x) byKey(event, group, [x.min, x.max]);
  };
  return html`<div class="chart"><div class="plot" role="img" tabindex="0" aria-label=${`${label}. Keys: plus and minus zoom, arrows move, 0 shows all`} title="Drag to zoom; double click, or 0, shows all" ref=${place} onKeyDown=${keys}></div>
    <div class="under"><span class="said" ref=${said} aria-hidden="true"></span>${chosen ? html`<button class="small" onClick=${() => zoom(group, null)}>Show all</button>` : null}
      ${name ? html`<${Save} name=${name} title=${label} canvas=${() => place.current?.querySelector("canvas")} chart=${{ x: time, y: unit, series: series.map((s) => ({ label: s.label, look: s.look })), bands: bands ?? [], level: level ?? null, shared: data[0], each: data.slice(1).map((values) => [values]) }} />` : null}</div></div>`;
}

/** One quantity over another, in the order of time.
 * @param {{label: string, series: Drawn[], x: string, y: string, data: [Values, Values][], height: number, name: string}} props `data` has x and y of each series */
export function Curve({ label, series, x, y, data, height, name }) {
  const place = useRef(/** @type {HTMLElement | null} */ (null));
  const said = useRef(/** @type {HTMLElement | null} */ (null));
  const shape = JSON.stringify([series.map((s) => [s.label, s.colour]), x, y, height, dark.value]);
  useEffect(() => {
    const holder = /** @type {HTMLElement} */ (place.current);
    const all = [0, 1].map((side) => data.flatMap((pair) => pair[side].filter((v) => v !== null)));
    /** @param {number[]} values @returns {[number, number]} */
    const span = (values) => {
      let [low, high] = [Infinity, -Infinity];
      for (const value of values) [low, high] = [Math.min(low, value), Math.max(high, value)];
      const spare = Math.max(0.05 * (high - low), 1e-6);
      return [low - spare, high + spare];
    };
    const [xs, ys] = all.map(span);
    const drawn = (/** @type {uPlot} */ u, /** @type {number} */ k) => {
      const path = new Path2D();
      let pen = false;
      const [across, up] = data[k - 1];
      across.forEach((value, i) => {
        const height_ = up[i];
        if (value === null || height_ === null) {
          pen = false;
          return;
        }
        const at = /** @type {[number, number]} */ ([u.valToPos(value, "x", true), u.valToPos(height_, "y", true)]);
        if (pen) path.lineTo(...at);
        else path.moveTo(...at);
        pen = true;
      });
      return { stroke: path };
    };
    const made = new uPlot(
      {
        mode: 2,
        width: Math.max(holder.clientWidth, 200),
        height,
        series: [{}, ...series.map((s) => ({ ...s, paths: drawn, facets: [{ scale: "x", auto: false }, { scale: "y", auto: false }] }))],
        axes: [axis(x, 26), axis(y, room(56))],
        scales: { x: { time: false, range: () => xs }, y: { range: () => ys } },
        legend: { show: false },
        cursor: { drag: { x: false, y: false }, points: { show: false }, dataIdx: () => null },
        hooks: { setCursor: [(/** @type {uPlot} */ u) => {
          if (said.current) said.current.textContent = u.cursor.left < 0 ? "" : `${x.split(" / ")[0]} ${number(u.posToVal(u.cursor.left, "x"), 1)} · ${y.split(" / ")[0]} ${number(u.posToVal(u.cursor.top, "y"), 4)}`;
        }] },
      },
      [null, ...data],
      holder,
    );
    const sized = new ResizeObserver(() => made.setSize({ width: Math.max(holder.clientWidth, 200), height }));
    sized.observe(holder);
    return () => {
      sized.disconnect();
      made.destroy();
    };
  }, [shape, data]);
  return html`<div class="chart"><div class="plot" role="img" aria-label=${label} ref=${place}></div>
    <div class="under"><span class="said" ref=${said} aria-hidden="true"></span>
      <${Save} name=${name} title=${label} canvas=${() => place.current?.querySelector("canvas")} chart=${{ x, y, series: series.map((s) => ({ label: words(s.label), look: s.look })), bands: [], level: null, shared: null, each: data }} /></div></div>`;
}
