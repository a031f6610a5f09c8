// What the page's modules want of a browser, for tests in node: an address, its changes, and storage.
const listeners = {};
const storage = () => {
  const kept = new Map();
  return { getItem: (key) => kept.get(key) ?? null, setItem: (key, value) => kept.set(key, String(value)), removeItem: (key) => kept.delete(key) };
};
let hash = "";
export const asked = [];
/** What the server answers, by method and path; nothing else is there. */
export const answers = new Map();
Object.assign(globalThis, {
  addEventListener: (kind, listener) => (listeners[kind] ??= []).push(listener),
  sessionStorage: storage(),
  localStorage: storage(),
  history: { replaceState: () => {} },
  document: { hidden: false, addEventListener: () => {} },
  location: {
    pathname: "/",
    get hash() { return hash; },
    set hash(now) {
      hash = now;
      for (const listener of listeners.hashchange ?? []) listener({});
    },
  },
  fetch: async (path, { method, body, headers }) => {
    asked.push({ method, path, body, headers });
    const given = answers.get(`${method} ${path}`) ?? [404, { error: "no such path" }];
    // a symbol is what is no JSON, as a proxy's own page
    const json = async () => (typeof given[1] === "symbol" ? JSON.parse("<html>") : given[1]);
    return { ok: given[0] < 400, status: given[0], json };
  },
});
/** The page's module of this name. */
export const page = (name) => import(new URL(name, `file://${process.env.NEEDLE_RIG_STATIC}/`).href);
/** Until what was begun has come. */
export const settled = () => new Promise((done) => setTimeout(done, 20));
