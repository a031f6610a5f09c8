// Measured traces beside a model: each channel with its band of noise, and below it the residual in units of the noise.
import { Curve, Legend, Plot, dots, edges, line } from "./plot.js";
import { html, significant, words } from "./ui.js";

/** @typedef {import("./vendor/uplot.js").Values} Values */
/** @typedef {{name: string, unit: string, noise: number}} Channel */
/** @typedef {{file: string, title: string, time_s: number[], base_deg: Values, measured: Values[], model?: Values[], refit?: Values[] | null, motions: import("./plot.js").Mark[]}} Trial */

const BAND_SIGMAS = 2;
/** Of the strip below a trace, px. */
const STRIP = 130;

/** Measured minus model over the noise. @param {Values} measured @param {Values} model @param {number} noise */
const left = (measured, model, noise) => measured.map((value, i) => (value === null || model[i] === null ? null : (value - /** @type {number} */ (model[i])) / noise));

/** A trial from its first measured sample on: the turns before it wind the shaft up in the model, and are no part of the record.
 * @template {Trial} T @param {T} trial @returns {T} */
export function recorded(trial) {
  const from = trial.time_s.findIndex((_, i) => trial.measured.some((values) => values[i] !== null));
  if (from <= 0) return trial;
  const cut = (/** @type {Values} */ values) => values.slice(from);
  return { ...trial, time_s: trial.time_s.slice(from), base_deg: cut(trial.base_deg), measured: trial.measured.map(cut), model: trial.model?.map(cut), refit: trial.refit?.map(cut) };
}

/** The base and every channel, with models over them; `over` is the prediction of a candidate, by channel.
 * @param {{channels: Channel[], trial: Trial, stretch?: [number, number] | null, over?: {name: string, values: Values[]} | null, group: string, name?: string}} props */
export function Traced({ channels, trial, stretch = null, over = null, group, name = trial.file }) {
  const { model, refit } = trial;
  const measured = dots("measured", "--quiet");
  const held = line(refit ? "model as it stands" : "model", "--model");
  const others = [...(refit ? [line("refitted", "--c1", { dash: [5, 4] })] : []), ...(over ? [line(`with ${words(over.name)}`, "--other", { width: 2 })] : [])];
  return html`<${Legend} series=${model ? [measured, held, ...others] : [measured]} band=${model ? `noise, ± ${BAND_SIGMAS} σ` : ""} />
    <div class="grid2">${channels.map((channel, c) => {
      const chart = `${name}-${channel.name}`;
      const unit = `${words(channel.name)} / ${channel.unit}`;
      const own = model?.[c];
      if (!own) return html`<div id=${`trace-${channel.name}`}><h3>${words(channel.name)}</h3>
        <${Plot} name=${chart} label=${`${channel.name} over time`} unit=${unit} height=${200} cursor=${group} range=${stretch} marks=${trial.motions} series=${[measured]} data=${[trial.time_s, trial.measured[c]]} /></div>`;
      const noise = BAND_SIGMAS * channel.noise;
      const shifted = (/** @type {number} */ by) => own.map((v) => (v === null ? null : v + by));
      const more = [...(refit ? [refit[c]] : []), ...(over ? [over.values[c]] : [])];
      return html`<div id=${`trace-${channel.name}`}><h3>${words(channel.name)} <span class="quiet">noise ${significant(channel.noise)} ${channel.unit}</span></h3>
        <${Plot} name=${chart} label=${`${channel.name} over time, measured and model`} unit=${unit} height=${190} bands=${[[3, 4]]} cursor=${group}
          range=${stretch} marks=${trial.motions} series=${[measured, held, ...edges("noise"), ...others]} data=${[trial.time_s, trial.measured[c], own, shifted(noise), shifted(-noise), ...more]} />
        <${Plot} name=${`${chart}-residual`} label=${`${channel.name}: measured minus model, in units of the noise`} unit="residual / σ" height=${STRIP} level=${BAND_SIGMAS} least=${8} cursor=${group}
          range=${stretch} marks=${trial.motions} series=${[dots(held.label, "--model"), ...others.map((one) => dots(one.label, one.colour))]}
          data=${[trial.time_s, ...[own, ...more].map((values) => left(trial.measured[c], values, channel.noise))]} /></div>`;
    })}</div>`;
}

/** Torque over the base's angle: what friction and elasticity make of a turn and its way back.
 * @param {{trial: Trial, name: string}} props */
export function Loop({ trial, name }) {
  const { model, refit } = trial;
  const series = [line("measured", "--text"), ...(model ? [line(refit ? "model as it stands" : "model", "--model", { dash: [5, 4] })] : []), ...(refit ? [line("refitted", "--c1", { dash: [2, 3] })] : [])];
  return html`<${Legend} series=${series} />
    <${Curve} name=${`${name}-loop`} label="Torque at the base over the base's angle" x="base angle / °" y="torque / N·mm" height=${260} series=${series}
      data=${[trial.measured[0], ...(model ? [model[0]] : []), ...(refit ? [refit[0]] : [])].map((torque) => [trial.base_deg, torque])} />`;
}
