// What changes on the rig from run to run: each parameter that the watch identified, the range of its reference period, alarms.
import { Working, alive, begin, jobs } from "./jobs.js";
import { ask } from "./net.js";
import { Legend, Plot, dots, edges } from "./plot.js";
import { place, refuse, route } from "./store.js";
import { computed, effect, html, parameter, plain, sentence, signal, significant, untracked, words } from "./ui.js";

/** @typedef {import("./types").TrendChart} Chart */
/** @typedef {import("./types").TrendsDocument} Found */
/** @type {{value: Found | null}} */
const found = signal(null);

const looking = computed(() => jobs.value.filter((job) => job.kind === "watch"));
const stand = computed(() => JSON.stringify([place.value.view === "trends", looking.value.map((job) => [job.key, job.state])]));
effect(() => {
  void stand.value;
  if (untracked(() => place.value.view === "trends")) ask("GET", "trends").then((now) => (found.value = now), refuse);
});

/** What the page calls a parameter of the watch. @type {Record<string, string>} */
const NAMES = { misfit: "error that the model leaves", tip_lag_deg: "lag of the tip at the end" };
/** What stands beside an axis where the unit alone does not say it. @type {Record<string, string>} */
const AXES = { misfit: "error / noise", tip_lag_deg: "tip lag / °" };
/** @param {string} name */
const called = (name) => NAMES[name] ?? parameter(name);

export function Trends() {
  const now = found.value;
  const busy = looking.value.some(alive);
  return html`<h1>Trends</h1><p class="purpose">See what wears or drifts: rigidity, friction, lag and noise of the rig from run to run, with the range of a reference period.</p>
    <section class=${now?.alarm ? "card fault" : "card"} role=${now?.alarm ? "alert" : undefined}><h2>${now?.alarm ? "Something has changed" : "The watch"}</h2>
      ${now ? null : html`<p class="quiet" role="status">Loading …</p>`}
      ${now && !now.watched ? html`<p>No run was looked at yet. Each look identifies the parameters of every recorded run by itself, in some seconds a run.</p>` : null}
      ${now?.sentences.length ? now.sentences.map((text) => html`<p>${sentence(words(plain(text).replace(PARAMETER, parameter)))}</p>`) : null}
      <p class="buttons"><button class=${now && !now.watched ? "go" : ""} disabled=${busy} onClick=${() => begin({ kind: "watch" })}>Look at new runs</button>
        ${now?.not_judged.length ? html`<span class="quiet">${now.not_judged.length} ${now.not_judged.length === 1 ? "run is" : "runs are"} not judged; see below.</span>` : null}</p>
      <${Working} kinds=${["watch"]} of=${looking.value} /></section>
    ${now?.runs.length ? html`<section class="card"><h2>Run by run</h2>
      <${Legend} series=${[dots("a run", "--c1"), ...(now.charts.some((chart) => chart.since) ? [dots("since the change", "--c4")] : [])]} band=${now.charts.some((chart) => chart.range) ? `range of the first ${now.reference} runs, ± 3 σ` : ""} />
      ${now.charts.some((chart) => chart.range) ? html`<p class="quiet">The range shows single runs. An alarm sums small shifts of many runs up, so that it may come within the range, and no run alone raises it.</p>` : null}
      <div class="grid2">${now.charts.filter((chart) => chart.values.some((value) => value !== null)).map((chart) => html`<${Over} key=${chart.name} chart=${chart} runs=${now.runs} />`)}</div></section>` : null}
    ${now?.not_judged.length ? html`<section class="card"><details><summary>Runs that are not judged</summary><ul>${now.not_judged.map((one) => html`<li><a href=${route("runs", one.run)}>${one.run}</a>: ${words(one.why)}</li>`)}</ul></details></section>` : null}`;
}

/** The name that a sentence of the watch begins with. */
const PARAMETER = /^[a-z0-9_.]+_[a-z0-9_]+/;

/** One parameter over the runs. @param {{chart: Chart, runs: Found["runs"]}} props */
function Over({ chart, runs }) {
  const { values, range, since, uncertainties } = chart;
  const unit = chart.unit === "1" ? (chart.name === "misfit" ? "× noise" : "–") : chart.unit;
  const from = since ? runs.findIndex((one) => one.run === since) : -1;
  const after = values.map((value, k) => (from >= 0 && k >= from ? value : null));
  const before = values.map((value, k) => (from >= 0 && k >= from ? null : value));
  const last = Math.max(-1, ...values.map((value, k) => (value === null ? -1 : k)));
  const out = range && last >= 0 && (Number(values[last]) < Number(range[0]) || Number(values[last]) > Number(range[1]));
  const big = (/** @type {string} */ label, /** @type {string} */ name) => {
    const made = dots(label, name);
    return { ...made, points: { ...made.points, size: 6 } };
  };
  const flat = (/** @type {number | null} */ edge) => values.map(() => edge);
  return html`<div><h3>${called(chart.name)} ${since ? html`<span class="tag doubt">changed since <a href=${route("runs", since)}>${since}</a></span>` : out ? html`<span class="tag doubt">out of its range</span>` : null}</h3>
    <p class="quiet">last: ${significant(values[last])}${uncertainties[last] ? ` ± ${significant(uncertainties[last])}` : ""} ${unit}</p>
    <${Plot} name=${`trend-${chart.name}`} label=${`${called(chart.name)} over the runs`} unit=${AXES[chart.name] ?? unit} time="run" counts=${true} range=${[0.5, values.length + 0.5]} least=${2 * Math.max(0, ...uncertainties.map(Number))} height=${190} cursor="trends"
      series=${[big("run", "--c1"), big("since the change", "--c4"), ...(range ? edges("range") : [])]} bands=${range ? [[3, 4]] : []}
      data=${[values.map((_, k) => k + 1), before, after, ...(range ? [flat(range[1]), flat(range[0])] : [])]} /></div>`;
}
