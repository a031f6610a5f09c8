// What the server knows of the present data and model: results that are asked anew whenever these change.
import { alive, begin, cancel, done, jobs, result } from "./jobs.js";
import { ask, watching } from "./net.js";
import { about, refuse, subject } from "./store.js";
import { computed, effect, signal, untracked } from "./ui.js";

/** A result with the key of its job, and what was asked. @template {keyof import("./types").Results} K @typedef {import("./types").Results[K] & {key: string, asked: Record<string, unknown>}} Of */
/** Results of one subject, which `id` names; null where nothing was found yet.
 * @typedef {{id: string, compare: Of<"CompareResult"> | null, diagnose: Of<"DiagnoseResult"> | null, learn: Of<"LearnResult"> | null, guess: Of<"GuessResult"> | null}} Found */
/** @type {Found} */
const NOTHING = { id: "", compare: null, diagnose: null, learn: null, guess: null };
const KINDS = /** @type {const} */ (["compare", "diagnose", "learn", "guess"]);

/** @type {{value: Found}} */
const known = signal(NOTHING);
/** Never that of other data or of another model. @type {{value: Found}} */
export const found = computed(() => (known.value.id === subject.value?.id ? known.value : NOTHING));

/** @param {import("./jobs.js").Job} job */
const idOf = (job) => JSON.stringify([job.data.map((d) => d.key), job.model?.key ?? null]);
/** The jobs of the present subject, the newest last. @type {{value: import("./jobs.js").Job[]}} */
export const ofSubject = computed(() => jobs.value.filter((job) => idOf(job) === subject.value?.id));
/** Whether one runs that the present subject waits for. */
export const busy = computed(() => ofSubject.value.some(alive));

/** Whether the chosen data are recordings of another kind, of which it is not known what is what. */
export const recording = computed(() => about.value?.data.find((s) => s.key === subject.value?.data[0].key)?.kind === "recording");

/** The comparison that was begun because its data were chosen. */
let chosen = { id: "", key: "" };

/** @param {import("./store.js").Subject} of */
async function load(of) {
  const query = new URLSearchParams([...of.data.map((one) => ["data", one.key]), ...(of.model ? [["model", of.model.key]] : [])]);
  try {
    const kinds = await ask("GET", `results?${query}`);
    const now = { ...NOTHING, id: of.id };
    for (const kind of KINDS) {
      // while a newer one of the same subject is computed, the one before it is shown
      now[kind] = kinds[kind]?.state === "done" ? await result(kinds[kind].key) : known.value.id === of.id && kinds[kind] ? known.value[kind] : null;
    }
    if (subject.value?.id !== of.id) return;
    if (known.value.id !== of.id || KINDS.some((kind) => known.value[kind]?.key !== now[kind]?.key)) known.value = now;
    const first = recording.value ? "guess" : "compare";
    if (!kinds[first] && chosen.id !== of.id && !watching.value) await choose(of, first);
  } catch (error) {
    if (subject.value?.id === of.id) refuse(error);
  }
}

/** @param {import("./store.js").Subject} of @param {string} first */
async function choose(of, first) {
  chosen = { id: of.id, key: "" };
  const request = first === "guess" ? { kind: "guess", upload: of.data[0].key.replace("upload:", "") } : { kind: "compare", ...asked(of) };
  const key = await begin(request);
  if (key && chosen.id === of.id) chosen.key = key;
  if (key) await done(request);
}

/** Data and model as the server wants them. @param {import("./store.js").Subject} of */
export const asked = (of) => ({ data: of.data.map((one) => one.key), model: of.model?.key ?? null });

const stand = computed(() => JSON.stringify([subject.value?.id, recording.value, ofSubject.value.map((job) => [job.key, job.state])]));
effect(() => {
  void stand.value;
  const of = untracked(() => subject.value);
  untracked(() => follow(of));
});

/** @param {import("./store.js").Subject | null} of */
function follow(of) {
  // in another view a person waits for it still; other data were chosen in its place
  if (of && chosen.key && chosen.id !== of.id) {
    if (jobs.value.some((job) => job.key === chosen.key && alive(job))) cancel(chosen.key);
    chosen = { id: "", key: "" };
  }
  if (of) load(of);
}
