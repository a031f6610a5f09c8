// Stop: sent on both ways at once, and what became of it.
import { ask } from "./net.js";
import { html, number, signal } from "./ui.js";

/** So long a person waits before the emergency stop. */
const CONFIRM_MS = 1000;

/** What became of the newest stop. @type {{value: null | {state: "sent" | "confirmed" | "open", text: string}}} */
const told = signal(null);
/** Those on the WebSocket that were not answered yet. @type {Map<number, (error?: string) => void>} */
const waiting = new Map();
/** @type {WebSocket | null} */
let socket = null;
let key = 0;
let newest = 0;

/** Send stops on this WebSocket, too. @param {WebSocket} opened */
export function sendOn(opened) {
  socket = opened;
  opened.addEventListener("close", () => waiting.forEach((answer) => answer("the page's connection broke")));
}

/** What the WebSocket said of a stop. @param {{key: number, error?: string}} document */
export function answered(document) {
  waiting.get(document.key)?.(document.error);
}

/** A stop that was confirmed is said no longer. */
export function moveOn() {
  if (told.value?.state === "confirmed") told.value = null;
}

/** Stops the drive: no lease, no question; the daemon itself confirms it. @param {string} how */
export async function stop(how) {
  const content = { reason: `stopped by a person with ${how}` };
  const begun = performance.now();
  const mine = (newest += 1);
  /** @param {"confirmed" | "open"} state @param {string} text */
  const say = (state, text) => {
    if (mine === newest) told.value = { state, text };
  };
  // one that was not confirmed stays in red until one is
  if (told.value?.state !== "open") told.value = { state: "sent", text: "Stop sent …" };
  const late = setTimeout(() => say("open", "The daemon did not answer within 1 s."), CONFIRM_MS);
  try {
    await Promise.any([ask("POST", "rig/stop", content), onSocket(content)]);
    say("confirmed", `Stop sent … confirmed after ${number((performance.now() - begun) / 1000, 2)} s.`);
  } catch (error) {
    say("open", `The reason: ${/** @type {AggregateError} */ (error).errors[0].message}.`);
  } finally {
    clearTimeout(late);
  }
}

/** @param {object} content @returns {Promise<void>} */
function onSocket(content) {
  return new Promise((confirm, refuse) => {
    if (socket?.readyState !== WebSocket.OPEN) return refuse(new Error("the page's connection broke"));
    const mine = (key += 1);
    waiting.set(mine, (error) => {
      waiting.delete(mine);
      if (error === undefined) confirm();
      else refuse(new Error(error));
    });
    socket.send(JSON.stringify({ key: mine, ...content }));
  });
}

export function Stopped() {
  if (!told.value) return null;
  const { state, text } = told.value;
  return html`<p class=${`stopped ${state}`} role=${state === "open" ? "alert" : "status"}>
    ${state === "open" ? html`<strong>Stop NOT confirmed: use the emergency stop.</strong> ` : null}${text}
    ${state === "sent" ? null : html`<button onClick=${() => (told.value = null)} aria-label="Dismiss what became of the stop">×</button>`}</p>`;
}
