// The frame: which view is shown, the connection, the work that runs, and a stop that is always in reach.
import { Strip, followJobs } from "./jobs.js";
import { Live, connected, open, rig, watch } from "./live.js";
import { Models } from "./models.js";
import { access, watching } from "./net.js";
import { FIRST, about, look, place, said } from "./store.js";
import { Stopped, stop } from "./stop.js";
import { Workbench } from "./workbench.js";
import { Runs } from "./runs.js";
import { Effects } from "./effects.js";
import { Strategies } from "./strategies.js";
import { Trends } from "./trends.js";
import { effect, html, render, untracked } from "./ui.js";

/** @type {Record<string, [string, any]>} */
const VIEWS = {
  live: ["Live", Live],
  data: ["Workbench", Workbench],
  runs: ["Runs", Runs],
  trends: ["Trends", Trends],
  models: ["Models", Models],
  effects: ["Effects", Effects],
  strategies: ["Strategies", Strategies],
};
const view = () => (place.value.view in VIEWS ? place.value.view : FIRST);
effect(() => {
  document.title = `${place.value.name ? `${place.value.name} · ` : ""}${VIEWS[view()][0]} · needle-rig`;
});

function App() {
  if (access.value === "incomplete")
    return html`<main><h1>needle-rig</h1><p class="refusal" role="alert">This link is incomplete.
      Paste the full address from the terminal (it ends in <code>#token=…</code>).</p></main>`;
  const [, View] = VIEWS[view()];
  const state = rig.value;
  return html`
    <a class="skip" href="#content" onClick=${(/** @type {Event} */ e) => { e.preventDefault(); document.getElementById("content")?.focus(); }}>To the content</a>
    <header>
      <a class="brand" href="#/live">needle-rig</a>
      <nav aria-label="Pages">${Object.entries(VIEWS).map(
        ([name, [label]]) =>
          html`<a href=${`#/${name}`} aria-current=${view() === name ? "page" : undefined}>${label}</a>`,
      )}</nav>
      <p class=${`link ${connected.value ? "on" : "off"}`} role="status">
        ${connected.value
          ? html`${state?.rig.name.replace(/ *simulated */, " ").trim() || "rig"}${state?.rig.simulated ? html` <span class="tag">simulated</span>` : null}`
          : "no connection to the rig"}</p>
      ${watching.value ? html`<p class="watches"><strong>Watching</strong>: this address orders nothing, not even a stop.</p>` : html`<button class="stop" onClick=${() => stop("the page's button")} title="Escape or Space">Stop</button>`}
      <${Stopped} />
      <${Strip} />
      ${access.value === "stale" ? html`<p class="refusal" role="alert">This page's key is no longer valid. Open the address that the newest <code>needle-rig web</code> printed.</p>` : null}
      ${said.value && access.value === "in" ? html`<p class="refusal" role="alert"><span>${said.value}</span>
        <button onClick=${() => (said.value = "")} aria-label="Dismiss">×</button></p>` : null}
      ${about.value?.unkept ? html`<p class="quiet unkept">${about.value.unkept}.</p>` : null}
    </header>
    <main id="content" tabindex="-1"><${View} /></main>
    <footer><a href="glossary.html" target="_blank" rel="noopener">Glossary</a>. needle-rig is no medical device.
      ${state?.version ? ` The rig runs needle-rig ${state.version}.` : null}
      ${nodesSaid(state?.firmware)}</footer>`;
}

/** What each node says of its firmware. @param {Record<string, {text: string}> | undefined} nodes */
const nodesSaid = (nodes) => Object.entries(nodes ?? {}).map(([link, node]) => ` The ${link} node: ${node.text}.`);

/** Space belongs to what one writes in, and Escape to an open dialog. @param {EventTarget | null} at */
const writing = (at) => at instanceof HTMLElement && at.matches("input, textarea, select, [contenteditable]");

addEventListener(
  "keydown",
  (event) => {
    const space = event.key === " " && !(writing(event.target) && !rig.value?.moving && !rig.value?.run);
    if (watching.value || event.repeat || (event.key !== "Escape" && !space)) return;
    if (space && !inMotion()) return;
    event.preventDefault();
    stop(event.key === "Escape" ? "the page's Escape key" : "the page's Space key");
  },
  true,
);

const inMotion = () => Boolean(rig.value && (rig.value.run || rig.value.moving));

let begun = false;
effect(() => {
  if (access.value !== "in" || begun) return;
  begun = true;
  untracked(() => {
    open();
    watch();
    look();
    followJobs();
  });
});
render(html`<${App} />`, /** @type {HTMLElement} */ (document.getElementById("app")));
