// A law that no library holds: what was learnt, its curve where data are and where not, and a way into the model.
import { Legend, Plot, edges, line } from "./plot.js";
import { html, measured, number, parameter, words } from "./ui.js";

/** What `learn` says; `add` takes a law into the model.
 * @param {{found: import("./types").LearnResult, busy: boolean, add: (law: string) => void}} props */
export function LearntLaws({ found, busy, add }) {
  return html`<h3>A law that no effect of the library holds</h3>
    <p class="verdict">${words(found.verdict)}: ${found.sentence}</p>
    <p class="quiet">${found.tried} laws were tried; error on commands left out ${number(found.held_out_before, 2)} → ${number(found.held_out_after, 2)} times the noise.</p>
    ${found.laws.map((law, k) => html`<${LearntLaw} law=${law} busy=${busy} add=${() => add(found.files[k].replace(/\.py$/, ""))} />`)}`;
}

/** @param {{law: import("./types").LearntLaw, busy: boolean, add: () => void}} props */
function LearntLaw({ law, busy, add }) {
  const unit = law.unit === "1" ? "" : ` / ${law.unit}`;
  const along = law.variable_unit === "1" ? words(law.variable) : `${words(law.variable)} / ${law.variable_unit}`;
  const seen = law.value.map((v, i) => (Number(law.data[i]) > 0 ? v : null));
  const series = [line("curve where data are", "--model", { width: 2 }), line("beyond the data", "--quiet", { dash: [4, 4] }), ...edges("95 %"),
    ...law.halves.map((_, k) => line(`half ${k + 1} of the trials`, "--other", { width: 1, dash: [2, 3] }))];
  return html`<section class="law" aria-label=${law.words}><h4>${law.words}</h4>
    <p>${law.formula ? html`As a formula: <strong>${law.formula}</strong>. ` : null}Error on commands left out ${number(law.held_out_before, 2)} → <strong>${number(law.held_out_after, 2)}</strong> times the noise.</p>
    <ul>${law.parameters.map((p) => html`<li>${parameter(p.name)} = ${measured(Number(p.value), p.uncertainty)} ${p.unit === "1" ? "" : p.unit}</li>`)}
      ${law.tied_with.map((/** @type {string} */ other) => html`<li>cannot be told apart from: ${other}</li>`)}
      ${law.experiment ? html`<li><strong>Would tell them apart:</strong> ${law.experiment}</li>` : null}</ul>
    <${Legend} series=${series} band="95 %" />
    <${Plot} name=${law.words} label=${`${law.words}: the curve with its 95 % band`} unit=${`curve${unit}`} time=${along} height=${240} bands=${[[3, 4]]} series=${series}
      data=${[law.at, seen, law.value, law.high, law.low, ...law.halves]} />
    <p><button class="go" disabled=${busy} onClick=${add}>Add this law</button></p></section>`;
}
