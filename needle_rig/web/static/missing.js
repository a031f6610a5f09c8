// What is missing: the diagnosis with its rivals, the law that no library holds, and ways into the model.
import { asked, busy, found as known, ofSubject } from "./found.js";
import { Working, begin, done, result } from "./jobs.js";
import { LearntLaws } from "./law.js";
import { over } from "./residuals.js";
import { save } from "./net.js";
import { dataRoute, look, refuse, subject } from "./store.js";
import { html, number, parameter, plain, sentence, signal, significant, words } from "./ui.js";

const everyRow = signal(false);
const SHOWN_ROWS = 6;

/** @param {import("./jobs.js").Request} request what is asked of the present data and model */
async function about(request) {
  const of = subject.value;
  if (of) await begin({ ...asked(of), ...request });
}

/** Make a model of the present one, and go on with it, unless the person went elsewhere. @param {import("./jobs.js").Request} request */
async function make(request) {
  const of = subject.value;
  const job = of && (await done({ ...asked(of), ...request }));
  if (!job) return;
  await look();
  if (subject.value?.id === of.id) location.hash = dataRoute(of.data, { key: job.key, name: job.name });
}

/** @param {boolean} quick for one effect alone */
const diagnose = (quick) => about({ kind: "diagnose", quick });
const learn = () => about({ kind: "learn" });
/** @param {string[]} effects */
const adopt = (effects) => known.value.diagnose && make({ kind: "adopt", diagnosis: known.value.diagnose.key, chosen: effects });
/** @param {string} law */
const adoptLaw = (law) => known.value.learn && make({ kind: "add_effect", learnt: known.value.learn.key, effect: law });
/** @param {string} effect */
const addEffect = (effect) => make({ kind: "add_effect", effect });
const takeValues = () => make({ kind: "take_values" });

/** The diagnosis as one HTML file. */
async function report() {
  const of = subject.value;
  const { diagnose: told, compare } = known.value;
  const job = of && told && compare && (await done({ ...asked(of), kind: "report", diagnosis: told.key, compared: compare.key }));
  const made = job && (await result(job.key).catch(refuse));
  if (made) await save(`jobs/${job.key}/${made.file}`, `${of.data[0].name.replace(/^.*\//, "")}-report.html`).catch(refuse);
}

export function Missing() {
  if (!known.value.compare) return null;
  const found = known.value.diagnose;
  return html`<section class="card wide"><h2>3 · What is missing</h2>
    ${found ? html`<${Verdict} found=${found} />` : busy.value ? null : html`<p><button class="go" onClick=${() => diagnose(false)}>Diagnose</button>
      <span class="quiet"> tries every effect of the library on commands that were left out</span></p>
      <p><button onClick=${() => diagnose(true)}>Diagnose quickly</button>
      <span class="quiet"> one effect alone, in half the time or less</span></p>`}
    <${Working} kinds=${["diagnose", "learn", "adopt", "add_effect", "take_values", "report"]} of=${ofSubject.value} /></section>`;
}

/** @param {{found: import("./types").DiagnoseResult}} props */
function Verdict({ found }) {
  const choices = found.verdict !== "effect" ? [] : found.ties.length ? [...found.effects, ...found.ties] : [""];
  const values = found.model_values;
  return html`${values ? html`<h3>Its values</h3><ul aria-label="Its values">${values.sentences.map((/** @type {string} */ s) => html`<li>${s}</li>`)}</ul>
      ${values.contradict ? html`<p><button class=${found.verdict === "none" ? "go" : ""} disabled=${busy.value} onClick=${takeValues}>Take these values over</button>
        ${found.verdict === "none" ? "" : html` <span class="quiet"> of this structure, which lacks something</span>`}</p>` : null}<h3>Its structure</h3>` : null}
    ${found.verdict === "effect" && !found.ties.length ? html`<p class="verdict">The model lacks <strong>${words(found.effects.join(" and "))}</strong>.</p>
      <p>Adding it cuts the prediction error on unseen trials from ${significant(found.held_out_error_before)} to ${significant(found.held_out_error_after)} times the sensor noise.</p>`
      : html`<p class="verdict">${sentence(words(found.sentence))}</p><p>${found.errors_sentence}</p>`}
    ${found.quick ? html`<p>One effect alone was looked for. <button disabled=${busy.value} onClick=${() => diagnose(false)}>Look for several</button></p>` : null}
    ${found.reasons.length ? html`<ul>${found.reasons.map((r) => html`<li>${plain(r.sentence)}</li>`)}</ul>` : null}
    <p>${choices.map((effect) => html`<button class="go" disabled=${busy.value} onClick=${() => adopt(effect ? [effect] : [])}>
      Add ${words(effect || found.effects.join(" and "))}</button> `)}</p>
    ${found.next_experiment ? html`<p><strong>Would tell them apart:</strong> ${found.next_experiment.sentence}</p>` : null}
    <div class="scroll" tabindex="0" role="group" aria-label="Ranking"><table class="stacked"><thead><tr><th class="text">effect</th><th>held-out error / noise</th><th>error removed</th><th class="text">for and against</th></tr></thead>
      <tbody>${found.ranking.slice(0, everyRow.value ? undefined : SHOWN_ROWS).map((row) => html`<tr class=${found.effects.includes(row.effect) ? "named" : ""}>
        <th scope="row">${found.candidates[row.effect] ? html`<button aria-pressed=${over.value === row.effect}
            onMouseEnter=${() => (over.value = row.effect)} onFocus=${() => (over.value = row.effect)}
            onClick=${() => (over.value = row.effect)}>${words(row.effect)}</button>` : words(row.effect)}</th>
        <td data-label="held-out error / noise">${number(row.held_out_error, 2)}</td><td data-label="error removed">${number(100 * Number(row.error_removed), 0)} %</td>
        <td class="text">${row.in_favour}${row.against ? html`; against: ${row.against}` : null}
          ${Object.entries(row.parameters).map(([name, v]) => html`<br /><span class="quiet">${parameter(name)} = ${significant(v.value)} (95 %: ${significant(v.low)} to ${significant(v.high)}) ${v.unit === "1" ? "" : v.unit}</span>`)}</td></tr>`)}</tbody></table></div>
    ${found.ranking.length > SHOWN_ROWS ? html`<p><button aria-expanded=${everyRow.value} onClick=${() => (everyRow.value = !everyRow.value)}>${everyRow.value ? "Fewer" : `${found.ranking.length - SHOWN_ROWS} more`}</button></p>` : null}
    ${found.way_on ? html`<h3>How to go on</h3><ul aria-label="How to go on">${found.way_on.sentences.map((/** @type {string} */ s) => html`<li>${words(s)}</li>`)}</ul>
      ${found.way_on.part ? html`<p><button disabled=${busy.value} onClick=${() => addEffect(found.way_on?.part ?? "")}>Add ${words(found.way_on.part)}</button></p>` : null}` : null}
    ${known.value.learn ? html`<${LearntLaws} found=${known.value.learn} busy=${busy.value} add=${adoptLaw} />`
      : found.verdict === "unknown" ? html`<p><button class="go" disabled=${busy.value} onClick=${learn}>Learn the law</button>
        <span class="quiet"> searches where it acts, on what it depends, its curve and a formula; minutes</span></p>` : null}
    ${found.left_over.length ? html`<h3>Left over</h3><ul>${found.left_over.map((/** @type {string} */ s) => html`<li>${s}</li>`)}</ul>` : null}
    <p class="buttons"><button disabled=${busy.value} title="One file with the answer, its numbers and pictures, to send" onClick=${report}>Report as one file</button></p>
    ${found.notes.length ? html`<details><summary>Notes</summary><ul>${found.notes.map((/** @type {string} */ s) => html`<li>${s}</li>`)}</ul></details>` : null}`;
}

