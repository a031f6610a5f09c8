// The one client of the server's jobs: begin, follow, cancel, and the strip that shows them in every view.
import { ask } from "./net.js";
import { dataOf, dataRoute, look, refuse, route, said } from "./store.js";
import { computed, html, number, plain, signal, words } from "./ui.js";

const BUSY_MS = 250;
const IDLE_MS = 3000;
const SEEN = "needle-rig-seen";

/** @typedef {import("./types").JobDocument} Job */
/** @typedef {import("./types").Work} Request */
/** Those that run and those that were asked last, the newest last. @type {{value: Job[]}} */
export const jobs = signal([]);
/** Results by job. @type {Map<string, Promise<any>>} */
const results = new Map();
const KEPT_RESULTS = 12;
/** Those whose end somebody waits for. @type {Map<string, (job: Job) => void>} */
const waiting = new Map();
/** Ended jobs that a person has looked at or dismissed, in any tab. @type {{value: string[]}} */
const seen = signal(JSON.parse(localStorage.getItem(SEEN) ?? "[]"));
const SEEN_KEPT = 100;
let timer = 0;

/** What a job is called. @type {Record<string, string>} */
const KINDS = {
  compare: "Compare", diagnose: "Diagnose", take_values: "Take values over from", adopt: "Add what is missing in", add_effect: "Add an effect to", undo: "Undo",
  learn: "Learn the law of", strategies: "Strategies", guess: "Assign columns of", import: "Import", figure: "Draw", report: "Write the report on", chart: "Draw a chart", open: "Open model", show: "Show", export: "Export", example: "Example data", watch: "Look at new runs",
};
/** Kinds whose end is worth a word in every view; the others are seen where they were asked. */
const TOLD = ["diagnose", "learn", "strategies", "adopt", "add_effect", "take_values", "import", "example", "watch"];
/** Kinds after which there is more to choose. */
const MAKING = ["adopt", "add_effect", "undo", "take_values", "open", "import", "example"];

/** @param {Job} job */
export const alive = (job) => job.state === "waiting" || job.state === "running";

/** Ask how far all are, and again: soon while one runs. */
async function follow() {
  clearTimeout(timer);
  try {
    if (!document.hidden || waiting.size || jobs.value.some(alive)) heard((await ask("GET", "jobs")).jobs);
  } catch {
    // the header shows the connection
  }
  timer = setTimeout(follow, waiting.size || jobs.value.some(alive) ? BUSY_MS : IDLE_MS);
}

/** @param {Job[]} now */
function heard(now) {
  const before = new Map(jobs.value.map((job) => [job.key, job]));
  if (JSON.stringify(now) !== JSON.stringify(jobs.value)) jobs.value = now;
  const ran = (/** @type {Job | undefined} */ job) => !job || alive(job);
  // at the first word after a reload, too: one may have ended since what can be chosen was asked
  const made = now.some((job) => !alive(job) && MAKING.includes(job.kind) && ran(before.get(job.key)));
  if (made) look();
  for (const job of now.filter((one) => !alive(one))) {
    waiting.get(job.key)?.(job);
    waiting.delete(job.key);
  }
}

/** Begin a computation, or find that of the same question: its key, or null when it was refused.
 * @param {Request} request @returns {Promise<string | null>} */
export async function begin(request) {
  said.value = "";
  try {
    const { job } = await ask("POST", "jobs", request);
    clearTimeout(timer);
    timer = setTimeout(follow, 0);
    return job;
  } catch (error) {
    refuse(error);
    return null;
  }
}

/** Do a computation to its end: its job, or null when it was refused, failed or was cancelled.
 * @param {Request} request @returns {Promise<Job | null>} */
export async function done(request) {
  const key = await begin(request);
  if (!key) return null;
  const job = await new Promise((end) => {
    waiting.set(key, end);
    clearTimeout(timer);
    timer = setTimeout(follow, 0);
  });
  if (job.state === "done") return job;
  if (job.state === "failed" && !TOLD.includes(job.kind)) said.value = plain(job.error);
  return null;
}

/** What a job that is done found. @param {string} key @returns {Promise<any>} */
export function result(key) {
  let found = results.get(key);
  if (!found) {
    found = ask("GET", `jobs/${key}`).then((job) => ({ ...job.result, key, asked: job.asked }));
    found.catch(() => results.delete(key));
    results.set(key, found);
    for (const old of [...results.keys()].slice(0, -KEPT_RESULTS)) results.delete(old);
  }
  return found;
}

/** @param {string} key */
export const cancel = (key) => ask("DELETE", `jobs/${key}`).then(follow, refuse);

/** Where the result of a job is seen. @param {Job} job */
function seenAt(job) {
  const made = job.state === "done" && job.name ? { key: job.key, name: job.name } : job.model;
  if (job.kind === "strategies") return route("strategies", "", job.model ? [["model", job.model.name]] : []);
  if (job.kind === "open") return job.name ? route("models", job.name) : route("data");
  if (job.kind === "watch") return route("trends");
  if (job.kind === "show") return route("runs");
  const imported = dataOf(`imported:${job.key}`);
  if (imported) return dataRoute([imported]);
  return dataRoute(job.data, job.kind === "learn" ? job.model : made);
}

/** @param {Job} job */
const subjectOf = (job) => [job.data.map((d) => d.name).join(", "), job.model ? `with ${words(job.model.name)}` : ""].filter(Boolean).join(" ");

/** What came up to this job is known. @param {string} key */
function dismiss(key) {
  const until = jobs.value.findIndex((job) => job.key === key);
  const known = jobs.value.filter((job, k) => k <= until && !alive(job)).map((job) => job.key);
  seen.value = [...new Set([...seen.value, ...known])].slice(-SEEN_KEPT);
  localStorage.setItem(SEEN, JSON.stringify(seen.value));
}
addEventListener("storage", (event) => {
  if (event.key === SEEN) seen.value = JSON.parse(event.newValue ?? "[]");
});

/** Time that is left, as people say it. @param {number} seconds */
const left = (seconds) => (seconds >= 90 ? `about ${Math.round(seconds / 60)} min left` : `about ${number(seconds, 0)} s left`);

/** How far a job is, with a way to end it. @param {{job: Job}} props */
export function Progress({ job }) {
  return html`<span class="job"><span class="step">${words(job.step)}${job.total ? ` · ${job.done} of ${job.total}` : ""}${job.left_s === null ? ` · ${number(job.elapsed_s, 0)} s` : ` · ${left(job.left_s)}`}</span>
    <progress aria-label=${job.step} max=${job.total || 1} value=${job.total ? job.done : undefined}></progress>
    <button onClick=${() => cancel(job.key)}>Cancel</button></span>`;
}

/** The job of these kinds that runs for `of`, where its button stands. @param {{kinds: string[], of: Job[]}} props */
export function Working({ kinds, of }) {
  return of.filter((job) => kinds.includes(job.kind) && alive(job)).map((job) => html`<p role="status" key=${job.key}><${Progress} job=${job} /></p>`);
}

const ended = computed(() => jobs.value.filter((job) => TOLD.includes(job.kind) && (job.state === "done" || job.state === "failed") && !seen.value.includes(job.key)).slice(-1));

/** What runs, and what came and was not looked at yet. */
export function Strip() {
  const running = jobs.value.filter(alive);
  const came = ended.value.filter((job) => {
    const at = seenAt(job);
    if (job.state === "done" && location.hash === at) queueMicrotask(() => dismiss(job.key));
    return true;
  });
  if (!running.length && !came.length) return null;
  return html`<section class="strip" aria-label="Work">
    ${running.map((job) => html`<div key=${job.key}><a href=${seenAt(job)}>${KINDS[job.kind]} ${subjectOf(job)}</a> <${Progress} job=${job} /></div>`)}
    ${came.map((job) => html`<div key=${job.key} class=${job.state} role=${job.state === "failed" ? "alert" : "status"}><strong>${KINDS[job.kind]} ${subjectOf(job)}</strong> ${job.state === "done" ? html`<span>done</span> <a href=${seenAt(job)} onClick=${() => dismiss(job.key)}>Show the result</a>` : html`<span>${plain(job.error)}</span>`}
      <button onClick=${() => dismiss(job.key)} aria-label="Dismiss what came of the work">×</button></div>`)}</section>`;
}

/** Begin to follow the server's jobs. */
export function followJobs() {
  document.addEventListener("visibilitychange", () => document.hidden || follow());
  follow();
}
