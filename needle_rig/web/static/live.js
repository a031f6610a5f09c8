// The rig as it is now: the shaft, torque and angles over time, the sequence, orders, and faults as sentences.
import { ask, subprotocol, watching, whyNot } from "./net.js";
import { Alarm, expected, forget, hear, laid } from "./expected.js";
import { Opening } from "./opening.js";
import { Legend, Plot, edges, line } from "./plot.js";
import { Shaft } from "./shaft.js";
import { about, dataRoute, place, refuse, route, run, said } from "./store.js";
import { answered, moveOn, sendOn } from "./stop.js";
import { Cells, Heads, batch, html, number, plain, sentence, signal, useEffect, useSignal, typeset, words, written } from "./ui.js";

const SILENT_MS = 800;
const AGAIN_MS = 300;
const SHOWN_S = 40;
/** So far a document of a change may be ahead of the states, which come at their own rate. */
const OVERTAKEN_S = 2;
/** Of what is expected, after now. */
const AHEAD_S = 8;
/** As the page's server takes the lease. */
const OWN_LEASE = "a person at the page";
const DRAW_MS = 1000 / 30;
/** The watch looks at a run in a quarter of a minute. */
const WATCH_MS = 15_000;

/** @typedef {import("./types").State | import("./types").Moved} State */
/** @typedef {import("./vendor/uplot.js").Values} Values */
/** The daemon's newest state; kept, greyed, when the connection is lost. @type {{value: State | null}} */
export const rig = signal(null);
export const connected = signal(false);
/** Why there is no connection. */
const why = signal("connecting …");
/** Matrix of the shaft's estimate. @type {{value: import("./types").EstimateDocument | null}} */
const estimate = signal(null);
/** @type {{value: import("./types").Told | null}} */
const ended = signal(null);
/** What the newest run says against the model of the rig file, and that the daemon is of another version. */
const besides = signal(/** @type {string[]} */ ([]));
/** Traces: time, base, each Hall angle; time, torque. @type {{value: {angles: Values[], torque: Values[]}}} */
const traces = signal({ angles: [[]], torque: [[], [], [], [], []] });
/** @type {number[][]} */
let columns = [];
let heard = 0;
let drawn = 0;

/** Any other order. @param {string} name @param {object} [content] */
async function order(name, content = {}) {
  said.value = "";
  ended.value = null;
  forget();
  moveOn();
  try {
    await ask("POST", `rig/${name}`, content);
  } catch (error) {
    refuse(error);
  }
}

/** Begin to listen, and again whenever the connection breaks. */
export function open() {
  const socket = new WebSocket(`${location.protocol.replace("http", "ws")}//${location.host}/api/live`, ["needle-rig", subprotocol()]);
  sendOn(socket);
  socket.onmessage = (event) => take(JSON.parse(event.data));
  socket.onclose = () => {
    lose(why.value);
    whyNot().then(lose).finally(() => setTimeout(open, AGAIN_MS));
  };
}

/** Ask what the watch over the runs says of the rig's model, and of versions; again while this page is looked at. */
export async function watch() {
  if (!document.hidden) besides.value = await ask("GET", "watch").then((found) => [found.version, found.contradiction].filter(Boolean), () => besides.value);
  setTimeout(watch, WATCH_MS);
}

setInterval(() => {
  if (connected.value && performance.now() - heard > SILENT_MS) lose("the daemon is silent");
}, 100);

/** @param {string} text */
function lose(text) {
  connected.value = false;
  why.value = text;
}

/** What the WebSocket says: the daemon's documents, and those of the page's own server. @typedef {State | import("./types").Ended | {type: "lost", text: string} | {type: "stop", key: number, error?: string} | ({type: "expected"} & Parameters<typeof hear>[0])} Said */
/** @param {Said} document */
function take(document) {
  if (document.type === "lost") return lose(document.text);
  if (document.type === "stop") return answered(document);
  heard = performance.now();
  if (document.type === "expected") return hear(document);
  if (document.type === "ended") {
    ended.value = document;
    return;
  }
  if (document.sensors) collect(document);
  const due = heard - drawn >= DRAW_MS * 0.8 || document.type !== "state";
  if (!due && connected.value) return;
  drawn = heard;
  batch(() => {
    connected.value = true;
    const before = rig.value;
    // the daemon tells of its last run until the next one; a jog or another order since then has no part in it
    if (document.moving && !document.run) ended.value = null;
    else if (document.last && (!before || JSON.stringify(document.last) !== JSON.stringify(before.last))) ended.value = document.last;
    rig.value = document;
    if (columns.length) {
      const now = columns[0].at(-1) ?? 0;
      const of = document.model_sha256 ? expected.value : null;
      const ahead = of?.ahead?.time_s.filter((time) => time > now && time < now + AHEAD_S) ?? [];
      const known = of && { ...of, ahead: of.ahead && cut(of.ahead, ahead) };
      const later = ahead.map(() => null);
      const times = columns[0];
      const ago = [...times, ...ahead].map((time) => time - now);
      const measured = columns.slice(1).map((values) => [...values, ...later]);
      const none = ago.map(() => null);
      const expects = (/** @type {number} */ k) => (known ? laid(known, k, times) : [none, none, none]);
      const halls = measured.slice(2).map((_, k) => expects(k + 1));
      traces.value = { angles: [ago, measured[0], ...measured.slice(2), ...halls.flat()], torque: [ago, measured[1], ...expects(0)] };
    }
    if (JSON.stringify(before?.rig) !== JSON.stringify(document.rig)) {
      ask("POST", "estimate", document.rig).then((found) => (estimate.value = found), () => (estimate.value = null));
    }
  });
}

/** A course at some of its times. @param {import("./expected.js").Course} course @param {number[]} times */
function cut(course, times) {
  const from = times.length ? course.time_s.indexOf(times[0]) : course.time_s.length;
  /** @param {number[]} values */
  const part = (values) => values.slice(from, from + times.length);
  return { time_s: times, mean: course.mean.map(part), deviation: course.deviation.map(part) };
}

/** Keep the last seconds. @param {State} state */
function collect(state) {
  const { sensors, time_s } = state;
  if (!sensors || time_s === null) return;
  const row = [time_s, sensors.base_deg, sensors.torque_nmm, ...sensors.hall_deg];
  const last = columns[0]?.at(-1) ?? time_s;
  // a time that goes back by more than documents overtake each other is that of another daemon
  if (columns.length !== row.length || time_s < last - OVERTAKEN_S || time_s - last > SHOWN_S) columns = row.map(() => []);
  if (columns[0].length && time_s <= last) return;
  columns.forEach((column, k) => column.push(/** @type {number} */ (row[k])));
  let old = 0;
  while (columns[0][old] < time_s - SHOWN_S) old += 1;
  if (old > 0) columns.forEach((column) => column.splice(0, old));
}

const PURPOSE = "See the needle as it is now, turn its base, and take the windup out of it.";

export function Live() {
  const state = rig.value;
  if (!state)
    return html`<h1>Live</h1><p class="purpose">${PURPOSE}</p>
      <div class="grid2"><section class="card wide"><h2>No rig</h2><p class="lost">${why.value}</p>
      <p>The workbench, the effects and the strategies work without a rig.</p></section><${Opening} /></div>`;
  return html`
    <h1>Live</h1><p class="purpose">${PURPOSE}</p>
    ${connected.value ? null : html`<p class="refusal" role="alert">The connection is lost: ${why.value}.
      What is shown is the last that was heard.</p>`}
    <div class=${connected.value ? "live" : "live grey"} inert=${!connected.value}>
      <${Faults} state=${state} />
      <div class="wide alarm"><${Alarm} model=${state.model} /></div>
      <section class="card wide">
        <h2>Shaft</h2>
        <${Shaft} state=${state} estimate=${estimate.value} />
      </section>
      <${Sequence} state=${state} />
      <${Orders} state=${state} />
      <${Charts} state=${state} />
      <${Settled} state=${state} />
    </div>`;
}

/** What was measured, and what the model of the run expects of it. @param {{state: State}} props */
function Charts({ state }) {
  const of = state.model_sha256 ? expected.value : null;
  const told = of?.past.time_s.length ? `expected by ${words(state.model ?? "")}, ± ${of.band_sigma} σ` : "";
  const range = [-SHOWN_S, told ? AHEAD_S : 0];
  const halls = state.rig.hall_positions_mm.map((/** @type {number} */ _, /** @type {number} */ k) => `--c${k + 1}`);
  const shown = [line("base", "--base"), ...halls.map((/** @type {string} */ name, /** @type {number} */ k) => line(`hall ${k + 1}`, name))];
  const expects = (/** @type {string} */ name, /** @type {string} */ colour) => [line(`${name} expected`, colour, { dash: [5, 4] }), ...edges(`${name} expected`)];
  const angles = [...shown, ...halls.flatMap((/** @type {string} */ name, /** @type {number} */ k) => expects(`hall ${k + 1}`, name))];
  const first = shown.length + 2;
  // one reading is no trace: time of a simulated rig stands still until the next order
  const none = traces.value.angles[0].length < 2 ? html`<p class="quiet nothing">Drawn from the next motion on.</p>` : null;
  return html`<section class="card half"><h2>Angles</h2><${Legend} series=${shown} band=${told} />
      <${Plot} name="live-angles" label="Angles of the base and the Hall sensors over the last 40 seconds" unit="angle / °" time="time before now / s" least=${4} range=${range} height=${230}
        series=${angles} bands=${halls.map((/** @type {string} */ _, /** @type {number} */ k) => [first + 3 * k, first + 3 * k + 1])} data=${traces.value.angles} />${none}</section>
    <section class="card half"><h2>Torque at the base</h2><${Legend} series=${[line("torque", "--c0")]} band=${told} />
      <${Plot} name="live-torque" label="Torque at the base over the last 40 seconds" unit="torque / N·mm" time="time before now / s" least=${0.02} range=${range} height=${230}
        series=${[line("torque", "--c0"), ...expects("torque", "--c0")]} bands=${[[3, 4]]} data=${traces.value.torque} />${none}</section>`;
}

/** @param {{state: State}} props */
function Faults({ state }) {
  const sensors = state.sensors;
  const next = [];
  if (sensors?.emergency_stop) next.push("The emergency stop is pressed. Release it, then clear.");
  if (sensors && sensors.age_ms.drive !== null && !sensors.referenced)
    next.push("The drive's zero is not known. Home it: by Hall sensor, or set an angle here.");
  if (state.latched) next.push("This fault stays until a person has looked: mend its cause, then Clear.");
  if (state.released) next.push("The base is released. Clear, or any motion, takes it again.");
  const told = [...(state.fault ? [state.fault] : []), ...next, ...state.warnings, ...besides.value];
  if (!told.length) return null;
  return html`<section class="card wide fault" role="alert"><h2>${state.fault ? "Fault" : "To do"}</h2>
    <ul>${told.map((text) => html`<li>${plain(text)}</li>`)}</ul></section>`;
}

/** The listed name of a run file. @param {string} path */
const nameOf = (path) => path.replace(/^.*\//, "").replace(/\.h5$/, "");

const PHASES = {
  idle: "at rest", rest: "reads the rest", moving: "moves", settling: "settles", measuring: "measures", holding: "holds the base",
  done: "done", fault: "fault", aborted: "stopped",
};

/** @param {{state: State}} props */
function Sequence({ state }) {
  const settled = state.settled;
  const active = Boolean(state.run) || state.moving;
  const count = Math.max(state.motions_expected, settled.length);
  const steps = Array.from({ length: count }, (_, k) => {
    // the first settled entry of a run may be the rest before its first motion
    const done = settled.filter((m) => m.phase !== "rest")[k];
    const now = active && !done && state.phase !== "rest" && k === settled.filter((m) => m.phase !== "rest").length;
    // while the next one is planned the daemon still tells of the one before
    const named = now && state.motion !== settled.at(-1)?.phase ? state.motion : `motion ${k + 1}`;
    return { name: done?.phase ?? named, done: Boolean(done), now };
  });
  const phase = /** @type {Record<string, string>} */ (PHASES)[state.phase] ?? state.phase;
  return html`<section class="card half"><h2>Sequence</h2>
    <p class="phase"><strong>${active && state.motion && state.motion !== state.phase ? `${words(state.motion)}: ${phase}` : phase}</strong>
      ${state.waiting_for ? html` · waits for ${state.waiting_for}` : null}
      ${state.remaining_s !== null && active ? html` <span class="countdown">${number(state.remaining_s, 1)} s</span>` : null}</p>
    ${active && state.phase !== "holding" ? html`<progress max="1" value=${state.progress} aria-label="Progress of the sequence"></progress>` : null}
    ${state.target_deg !== null ? html`<p>${words(state.strategy ?? "")} to ${number(state.target_deg, 1)}°${state.model ? ` with the model ${words(state.model)}` : ""}</p>` : null}
    ${!count && !ended.value ? html`<p class="quiet">Compensate turns the base in several motions; each is shown here while it goes.</p>` : null}
    <ol class="steps">${steps.map((step) => html`<li class=${step.done ? "done" : step.now ? "now" : ""}
      aria-current=${step.now ? "step" : undefined}>${words(step.name)}</li>`)}</ol>
    ${!active && ended.value ? html`<p class="ended">${state.rig.simulated ? "Simulated: " : ""}${plain(ended.value.text).replace(/[^.]$/, "$&.")}</p>
      ${ended.value.result?.run ? html`<p class="buttons"><a class="button" href=${route("runs", nameOf(ended.value.result.run))}>This run</a> <a class=${ended.value.result.status === "not_aligned" ? "button go" : "button"} href=${dataRoute([run(nameOf(ended.value.result.run))])}>Diagnose this run</a></p>` : null}` : null}</section>`;
}

/** @param {{state: State}} props */
function Orders({ state }) {
  const all = about.value?.models ?? [];
  // no word of a model in the address: the one that was set as the rig's
  const kept = about.value?.rig_model?.name ?? "";
  const wanted = (place.value.view === "live" ? place.value.query.get("model") : null) ?? kept;
  const model = all.find((m) => m.name === wanted);
  const target = useSignal("45");
  const strategy = useSignal("reed2008");
  // a model is given to plan with it
  useEffect(() => {
    strategy.value = wanted ? "planned" : "reed2008";
  }, [wanted]);
  const by = useSignal("10");
  const busy = Boolean(state.run) || state.moving;
  const known = about.value?.strategies ?? [];
  const text = known.find((s) => s.name === strategy.value)?.text ?? "";
  // a button that was pressed keeps the focus: it is not disabled while the needle moves
  /** @param {string} name @param {object} [content] */
  const give = (name, content) => busy || order(name, content);
  // a held base is released without a stop before it
  const held = state.phase === "holding";
  /** @param {{value: string}} s */
  const write = (s) => (/** @type {Event} */ e) => (s.value = written(e));
  if (watching.value) return html`<section class="card half"><h2>Orders</h2><p class="quiet">This address may watch and order nothing.${state.lease ? ` ${sentence(state.lease)} commands this rig.` : ""}</p></section>`;
  return html`<section class="card half"><h2>Orders</h2>
    ${state.lease ? html`<p class="quiet">${state.lease === OWN_LEASE ? "You have control, until ten seconds after the last order." : `${state.lease} commands this rig.`}</p>` : null}
    <form class="orders" onSubmit=${(/** @type {Event} */ e) => { e.preventDefault(); give("compensate", { target_deg: Number(target.value), strategy: strategy.value, model: model?.key ?? null }); }}>
      <label>Target <span class="unit"><input type="number" step="any" required value=${target.value} onInput=${write(target)} /> °</span></label>
      <label>Strategy <select value=${strategy.value} onChange=${write(strategy)}>${known.map((s) => html`<option value=${s.name} selected=${s.name === strategy.value} title=${s.text}>${words(s.name)}</option>`)}</select></label>
      <label>Model <select value=${model?.name ?? ""} onChange=${(/** @type {Event} */ e) => (location.hash = route("live", "", [["model", written(e)]]))}>
        <option value="" selected=${!model}>that of the rig file</option>${all.map((m) => html`<option value=${m.name} selected=${m === model}>${words(m.name)}</option>`)}</select></label>
      <button class="go" aria-disabled=${busy}>Compensate</button>
      ${text ? html`<p class="quiet all">${typeset(text)}</p>` : null}
      ${model ? html`<p class="quiet all">The run plans with <a href=${route("models", model.name)}>${words(model.name)}</a> and is held against it while it goes. Nothing turns before <em>Compensate</em>.${model.name === kept ? " It is set as this rig's model." : ""}</p>` : null}
      ${wanted && about.value && !model ? html`<p class="refusal all" role="alert">${wanted}: no such model here. Choose from the list.</p>` : null}
    </form>
    <form class="orders" onSubmit=${(/** @type {Event} */ e) => { e.preventDefault(); give("jog", { by_deg: Number(by.value) }); }}>
      <label>Jog by <span class="unit"><input type="number" step="any" required value=${by.value} onInput=${write(by)} /> °</span></label>
      <button aria-disabled=${busy}>Jog</button>
      <button type="button" aria-disabled=${busy} onClick=${() => give("home")}>Home</button>
      <button type="button" aria-disabled=${busy} onClick=${() => give("home", { by: "hall" })}>Home by Hall</button>
      <button type="button" aria-disabled=${busy} onClick=${() => give("hold")}>Hold</button>
      <button type="button" aria-disabled=${busy && !held} onClick=${() => (held ? order("release") : give("release"))}>Release</button>
      <button type="button" aria-disabled=${busy} onClick=${() => give("clear")}>Clear</button>
    </form>
    <p class="quiet">Escape stops at any time, Space while the needle moves.</p></section>`;
}

/** What the plan expected before each motion, beside what came. @param {{state: State}} props */
function Settled({ state }) {
  if (!state.settled.length) return null;
  const names = ["waypoint / °", "base / °", "torque / N·mm", "predicted lag / °", "measured lag / °", "difference / °",
    ...state.rig.hall_positions_mm.map((_, k) => `hall ${k + 1} / °`)];
  return html`<section class="card wide"><h2>Motions: predicted and measured</h2><div class="scroll" tabindex="0" role="group" aria-label="Table of motions"><table class="stacked numbers">
    <${Heads} of="motion" names=${names} />
    <tbody>${state.settled.map((m) => html`<tr><th scope="row">${words(m.phase)}</th><${Cells} names=${names} values=${[
      number(m.waypoint_deg, 1), number(m.base_deg, 2), number(m.torque_nmm, 4), number(m.predicted_lag_deg, 1), number(m.tip_lag_deg, 1),
      number(m.tip_lag_deg === null || m.predicted_lag_deg === null ? null : m.tip_lag_deg - m.predicted_lag_deg, 1),
      ...m.hall_deg.map((a) => number(a, 1))]} /></tr>`)}</tbody></table></div></section>`;
}
