// Requests to the page's own server: each carries the token of the printed address.
const KEY = "needle-rig-token";
const given = new URLSearchParams(location.hash.slice(1)).get("token");
if (given) {
  sessionStorage.setItem(KEY, given);
  history.replaceState(null, "", location.pathname);
}
export const token = sessionStorage.getItem(KEY) ?? "";

/** The answer to a request; throws an Error with the server's sentence.
 * @param {string} method @param {string} path @param {unknown} [content] @returns {Promise<any>} */
export async function ask(method, path, content) {
  const raw = content instanceof Blob;
  let response;
  try {
    response = await fetch(`/api/${path}`, {
      method,
      headers: { Authorization: `Bearer ${token}`, ...(raw ? {} : { "Content-Type": "application/json" }) },
      body: content === undefined ? undefined : raw ? content : JSON.stringify(content),
    });
  } catch {
    throw new Error("the page's server does not answer; start it again: needle-rig web");
  }
  const answer = await response.json().catch(() => ({ error: `the server answered ${response.status}` }));
  if (!response.ok || answer.error !== undefined && answer.exit_code !== undefined) throw new Error(answer.error);
  return answer;
}

/** Address of a file that the server made, as this page may show it; to be revoked.
 * @param {string} path */
export async function picture(path) {
  const response = await fetch(`/api/${path}`, { headers: { Authorization: `Bearer ${token}` } });
  if (!response.ok) throw new Error((await response.json()).error);
  return URL.createObjectURL(await response.blob());
}

/** Save a file that the server made.
 * @param {string} path @param {string} name */
export async function save(path, name) {
  const link = document.createElement("a");
  link.href = await picture(path);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

/** Run a computation to its end; `show` hears its progress, `begun` its key.
 * @param {any} request @param {(job: any) => void} show @param {(key: string) => void} [begun] @returns {Promise<any>} */
export async function compute(request, show, begun) {
  const { job } = await ask("POST", "jobs", request);
  begun?.(job);
  for (;;) {
    const now = await ask("GET", `jobs/${job}`);
    show({ ...now, key: job });
    if (now.state === "done") return { ...now.result, key: job };
    if (now.state !== "running") throw new Error(now.error);
    await new Promise((go) => setTimeout(go, 200));
  }
}
