// The frame: which page is shown, the connection, and a stop that is always in reach.
import { Live, connected, open, rig, said, watch } from "./live.js";
import { Stopped, stop } from "./stop.js";
import { Workbench } from "./workbench.js";
import { Runs } from "./runs.js";
import { Learn } from "./learn.js";
import { Strategies } from "./strategies.js";
import { html, render, signal } from "./ui.js";
import { token } from "./net.js";

/** @type {Record<string, [string, any]>} */
const PAGES = {
  live: ["Live", Live],
  workbench: ["Workbench", Workbench],
  runs: ["Runs", Runs],
  learn: ["Learn", Learn],
  strategies: ["Strategies", Strategies],
};
const page = signal("live");

function follow() {
  const name = location.hash.slice(2);
  page.value = name in PAGES ? name : "live";
  document.title = `${PAGES[page.value][0]} · needle-rig`;
}
addEventListener("hashchange", follow);

function App() {
  if (!token)
    return html`<main><h1>needle-rig</h1><p class="refusal" role="alert">This address has no token.
      Open the whole address that <code>needle-rig web</code> printed.</p></main>`;
  const [, Page] = PAGES[page.value];
  const state = rig.value;
  return html`
    <a class="skip" href="#content" onClick=${(/** @type {Event} */ e) => { e.preventDefault(); document.getElementById("content")?.focus(); }}>To the content</a>
    <header>
      <a class="brand" href="#/live">needle-rig</a>
      <nav aria-label="Pages">${Object.entries(PAGES).map(
        ([name, [label]]) =>
          html`<a href=${`#/${name}`} aria-current=${page.value === name ? "page" : undefined}>${label}</a>`,
      )}</nav>
      <p class=${`link ${connected.value ? "on" : "off"}`} role="status">
        ${connected.value
          ? html`${state?.rig.name}${state?.rig.simulated ? html` <span class="tag">simulated</span>` : null}`
          : "no connection to the rig"}</p>
      <button class="stop" onClick=${() => stop("the page's button")} title="Escape or Space">Stop</button>
      <${Stopped} />
    </header>
    ${said.value ? html`<p class="refusal" role="alert">${said.value}
      <button onClick=${() => (said.value = "")} aria-label="Dismiss">×</button></p>` : null}
    <main id="content" tabindex="-1"><${Page} /></main>
    <footer>Words: <a href="glossary.html">glossary</a>. needle-rig is no medical device.
      ${state?.version ? ` The rig runs needle-rig ${state.version}.` : null}</footer>`;
}

/** Space belongs to what one writes in, and Escape to an open dialog. @param {EventTarget | null} at */
const writing = (at) => at instanceof HTMLElement && at.matches("input, textarea, select, [contenteditable]");

addEventListener(
  "keydown",
  (event) => {
    const space = event.key === " " && !(writing(event.target) && !rig.value?.moving && !rig.value?.run);
    if (event.repeat || (event.key !== "Escape" && !space)) return;
    if (space && !inMotion()) return;
    event.preventDefault();
    stop(event.key === "Escape" ? "the page's Escape key" : "the page's Space key");
  },
  true,
);

const inMotion = () => Boolean(rig.value && (rig.value.run || rig.value.moving));

follow();
if (token) {
  open();
  watch();
}
render(html`<${App} />`, /** @type {HTMLElement} */ (document.getElementById("app")));
