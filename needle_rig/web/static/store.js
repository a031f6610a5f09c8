// What the page is about: the place in its address, what can be chosen, what was refused. Work itself lies on the server.
import { ask } from "./net.js";
import { computed, effect, plain, signal } from "./ui.js";

/** A key with the name that people read. @typedef {{key: string, name: string}} Named */
/** Data and the model that is held against them. @typedef {{data: Named[], model: Named | null, id: string}} Subject */
/** The view, the name behind it, and what else the address says. @typedef {{view: string, name: string, query: URLSearchParams}} Place */

export const FIRST = "live";

/** @param {string} hash @returns {Place} */
export function placeOf(hash) {
  const [path, query] = hash.replace(/^#\/?/, "").split("?");
  const [view, ...name] = path.split("/").map((part) => {
    try {
      return decodeURIComponent(part);
    } catch {
      return part;
    }
  });
  return { view: view || FIRST, name: name.join("/"), query: new URLSearchParams(query) };
}

/** @type {{value: Place}} */
export const place = signal(placeOf(location.hash));
addEventListener("hashchange", () => {
  place.value = placeOf(location.hash);
  said.value = "";
});

/** What was refused last. */
export const said = signal("");
/** @param {unknown} error */
export const refuse = (error) => (said.value = plain(/** @type {Error} */ (error).message));

/** What can be chosen: data, models, strategies, parameter sets. @type {{value: import("./types").AboutDocument | null}} */
export const about = signal(null);
/** Ask again what can be chosen. */
export const look = () => ask("GET", "about").then((found) => (about.value = found), refuse);

const path = (/** @type {string} */ name) => name.split("/").map(encodeURIComponent).join("/");

/** The address of a view, of a name in it, and what else it says.
 * @param {string} view @param {string} [name] @param {[string, string][]} [query] */
export const route = (view, name = "", query = []) => `#/${view}${name ? `/${path(name)}` : ""}${query.length ? `?${new URLSearchParams(query)}` : ""}`;

/** The address of data with a model. @param {Named[]} data @param {Named | null} [model] */
export function dataRoute(data, model = null) {
  const runs = data.filter((one) => one.key.startsWith("run:"));
  const query = /** @type {[string, string][]} */ (runs.map((run) => ["run", run.name]));
  if (model) query.push(["model", model.name]);
  return route("data", runs.length ? "" : data[0]?.name ?? "", query);
}

/** Data of a key, by the name that the server gives them: that of a file may be taken. @param {string} key @returns {Named | undefined} */
export const dataOf = (key) => about.value?.data.find((source) => source.key === key);

/** @param {string} key @returns {Named} */
export const run = (key) => ({ key: `run:${key}`, name: key });

/** The model that is called so; null for none. @param {string | null} name @returns {Named | null | undefined} */
export function modelCalled(name) {
  if (!name) return null;
  const found = about.value?.models.find((m) => m.name === name);
  if (found) return { key: found.key, name };
  return about.value?.parameters.includes(name) ? { key: name, name } : undefined;
}

/** Data and model that the address names; a sentence where there are none such. @type {{value: Subject | string | null}} */
const named = computed(() => {
  const { view, name, query } = place.value;
  if (view !== "data" || !about.value) return null;
  const source = about.value.data.find((s) => s.name === name);
  const data = name ? (source ? [{ key: source.key, name }] : []) : query.getAll("run").map(run);
  if (name && !source) return `${name}: no such data here. Choose from the list, or drop the files again.`;
  const model = modelCalled(query.get("model"));
  if (model === undefined) return `${query.get("model")}: no such model here. Choose from the list.`;
  return { data, model, id: JSON.stringify([data.map((one) => one.key), model?.key ?? null]) };
});
/** What the address says in vain. */
export const lost = computed(() => (typeof named.value === "string" ? named.value : ""));
/** The present data and model; null where no data are chosen. @type {{value: Subject | null}} */
export const subject = computed(() => (named.value && typeof named.value !== "string" && named.value.data.length ? named.value : null));
/** The data that were chosen last. @type {{value: Named[]}} */
export const heldData = signal([]);
effect(() => {
  if (subject.value) heldData.value = subject.value.data;
});
/** The model of the address, with data or without. @type {{value: Named | null}} */
export const heldModel = computed(() => (named.value && typeof named.value !== "string" ? named.value.model : null));
