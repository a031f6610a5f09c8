// A chart as a file: its picture as it is seen, its numbers, or drawn for print by the server.
import { done, result } from "./jobs.js";
import { save } from "./net.js";
import { refuse } from "./store.js";
import { html } from "./ui.js";

/** @typedef {import("./vendor/uplot.js").Values} Values */
/** A chart by its numbers: shared values along x, or null, and the values of each series: y alone, or x and y.
 * @typedef {{x: string, y: string, series: import("./types").ChartSeries[], bands: [number, number][], level: number | null, shared: Values | null, each: Values[][]}} Chart */

/** @param {Blob} content @param {string} name */
function download(content, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(content);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

/** @param {string} text */
const cell = (text) => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);

/** The numbers of a chart as a table. @param {Chart} chart */
export function csv(chart) {
  const columns = chart.shared ? [{ name: chart.x, values: chart.shared }] : [];
  chart.each.forEach(([first, second], k) => {
    const { label } = chart.series[k];
    if (second) columns.push({ name: `${label}: ${chart.x}`, values: first }, { name: `${label}: ${chart.y}`, values: second });
    else columns.push({ name: `${label}: ${chart.y}`, values: first });
  });
  const rows = Math.max(...columns.map((column) => column.values.length));
  const lines = [columns.map((column) => cell(column.name)).join(",")];
  for (let row = 0; row < rows; row += 1) lines.push(columns.map((column) => column.values[row] ?? "").join(","));
  return `${lines.join("\n")}\n`;
}

/** @param {{name: string, title: string, chart: Chart, canvas: () => HTMLCanvasElement | null | undefined}} props */
export function Save({ name, title, chart, canvas }) {
  const file = name.replace(/[^\p{L}\p{N}_.-]+/gu, "_");
  const picture = () => {
    const seen = canvas();
    if (!seen) return;
    const whole = document.createElement("canvas");
    [whole.width, whole.height] = [seen.width, seen.height];
    const ctx = /** @type {CanvasRenderingContext2D} */ (whole.getContext("2d"));
    ctx.fillStyle = getComputedStyle(document.documentElement).getPropertyValue("--card").trim();
    ctx.fillRect(0, 0, whole.width, whole.height);
    ctx.drawImage(seen, 0, 0);
    whole.toBlob((blob) => blob && download(blob, `${file}.png`));
  };
  const drawn = async () => {
    const job = await done({ kind: "chart", chart: { title, ...chart } });
    const made = job && (await result(job.key).catch(refuse));
    if (made) await save(`jobs/${job.key}/${made.file}`, `${file}.svg`).catch(refuse);
  };
  return html`<details class="save"><summary aria-label=${`Save the chart ${name}`}>Save</summary><span>
    <button class="small" onClick=${picture}>PNG</button> <button class="small" onClick=${drawn}>SVG</button>
    <button class="small" onClick=${() => download(new Blob([csv(chart)], { type: "text/csv" }), `${file}.csv`)}>CSV</button></span></details>`;
}
