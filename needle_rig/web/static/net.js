// Requests to the page's own server: with the token of the printed address, or with the session that it opened.
import { signal } from "./ui.js";

/** The page's half of the session, which every tab of this address may read. */
const PAGE = "needle-rig-page";
/** The token, until the session is open; it does not outlive this tab. */
const TOKEN = "needle-rig-token";

let token = sessionStorage.getItem(TOKEN) ?? "";
/** Whether this browser may ask: `incomplete` without a key, `stale` with one that the server does not know. @type {{value: "in" | "incomplete" | "stale"}} */
export const access = signal("incomplete");

/** Whether this address may see everything and order nothing. */
export const watching = signal(false);

/** Take the token of the address, and open a session for other tabs and for later. */
async function enter() {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given) {
    token = given;
    sessionStorage.setItem(TOKEN, token);
    history.replaceState(null, "", location.pathname);
  }
  if (!token && !localStorage.getItem(PAGE)) return;
  access.value = "in";
  if (!token) {
    ask("GET", "session").then((given) => (watching.value = given.watches), () => {});
    return;
  }
  try {
    const given = await ask("POST", "session");
    watching.value = given.watches;
    localStorage.setItem(PAGE, given.page);
    sessionStorage.removeItem(TOKEN);
  } catch {
    // told where it matters: this tab goes on with the token
  }
}

/** @returns {Record<string, string>} */
const credentials = () => (token ? { Authorization: `Bearer ${token}` } : { "X-Needle-Rig-Page": localStorage.getItem(PAGE) ?? "" });

/** What lets a WebSocket in. */
export const subprotocol = () => (token ? `token.${token}` : `page.${localStorage.getItem(PAGE) ?? ""}`);

const GONE = "The page's server does not answer. Start it again: needle-rig web.";
const STALE = "This page's key is no longer valid. Open the address that the newest needle-rig web printed.";

/** @param {string} method @param {string} path @param {BodyInit} [body] @param {Record<string, string>} [headers] */
async function sent(method, path, body, headers = {}) {
  let response;
  try {
    response = await fetch(`/api/${path}`, { method, headers: { ...credentials(), ...headers }, body });
  } catch {
    throw new Error(GONE);
  }
  if (response.status === 401) {
    access.value = "stale";
    throw new Error(STALE);
  }
  // a proxy answers for a server that is gone, or that is too slow for it
  if ([502, 504].includes(response.status)) throw new Error(`${GONE} Its proxy said ${response.status}.`);
  if (access.value === "stale") access.value = "in";
  return response;
}

/** The answer to a request; throws an Error with the server's sentence.
 * @param {string} method @param {string} path @param {unknown} [content] @returns {Promise<any>} */
export async function ask(method, path, content) {
  const raw = content instanceof Blob;
  const response = await sent(method, path, content === undefined ? undefined : raw ? content : JSON.stringify(content), raw ? {} : { "Content-Type": "application/json" });
  if (!response.ok) throw await refusal(response);
  return await response.json();
}

/** What a refusal says; a proxy's own page is no sentence. @param {Response} response */
async function refusal(response) {
  const { error } = await response.json().catch(() => ({}));
  return new Error(error ?? `The server, or a proxy before it, answered ${response.status}. Try again, or start needle-rig web again.`);
}

/** Why nothing comes from the server. @returns {Promise<string>} */
export const whyNot = () => ask("GET", "session").then(() => "the connection broke", (error) => error.message);

/** Address of a file that the server made, as this page may show it; to be revoked.
 * @param {string} path */
export async function picture(path) {
  const response = await sent("GET", path);
  if (!response.ok) throw await refusal(response);
  return URL.createObjectURL(await response.blob());
}

/** Save a file that the server made.
 * @param {string} path @param {string} name */
export async function save(path, name) {
  const href = await picture(path);
  const link = document.createElement("a");
  link.href = href;
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(href), 10_000);
}

addEventListener("hashchange", enter);
enter();
