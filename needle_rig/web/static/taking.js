// Files that a person drops or chooses: taken in, and shown where they belong.
import { done } from "./jobs.js";
import { ask } from "./net.js";
import { dataOf, dataRoute, look, refuse, route, said, subject } from "./store.js";
import { signal } from "./ui.js";

/** The file that is taken in now. */
export const taking = signal("");

/** Take in dropped files, folders included.
 * @param {DataTransferItemList | FileList} items */
export async function take(items) {
  said.value = "";
  const files = await everyFile(items);
  if (!files.length) return;
  let upload = "";
  let opens = false;
  let data = 0;
  try {
    ({ upload } = await ask("POST", "uploads", { name: files[0].path.split("/")[0] }));
    for (const { path, file } of files) {
      taking.value = path;
      ({ data, model: opens } = await ask("PUT", `uploads/${upload}/${path.split("/").map(encodeURIComponent).join("/")}`, file));
    }
  } catch (error) {
    return refuse(error);
  } finally {
    taking.value = "";
  }
  await look();
  if (!opens) return go(dataOf(`upload:${upload}`));
  const job = await done({ kind: "open", upload });
  if (!job) return;
  await look();
  const source = data ? dataOf(`upload:${upload}`) : null;
  const of = source ? [source] : subject.value?.data;
  location.hash = of ? dataRoute(of, job) : route("models", job.name);
}

/** @param {import("./store.js").Named | undefined} source */
function go(source) {
  if (source) location.hash = dataRoute([source]);
}

/** @param {DataTransferItemList | FileList} items @returns {Promise<{path: string, file: File}[]>} */
async function everyFile(items) {
  if (items instanceof FileList)
    return [...items].map((file) => ({ path: file.webkitRelativePath || file.name, file }));
  /** @type {{path: string, file: File}[]} */
  const found = [];
  /** @param {FileSystemEntry | null} entry @param {string} folder */
  const walk = async (entry, folder) => {
    if (entry instanceof FileSystemFileEntry) {
      const file = /** @type {File} */ (await new Promise((done, fail) => entry.file(done, fail)));
      if (!file.name.startsWith(".")) found.push({ path: folder + file.name, file });
      return;
    }
    if (!(entry instanceof FileSystemDirectoryEntry)) return;
    const reader = entry.createReader();
    for (;;) {
      const some = /** @type {FileSystemEntry[]} */ (await new Promise((done, fail) => reader.readEntries(done, fail)));
      if (!some.length) break;
      for (const one of some) await walk(one, `${folder}${entry.name}/`);
    }
  };
  const entries = [...items].map((item) => item.webkitGetAsEntry()).filter(Boolean);
  for (const entry of entries) await walk(entry, "");
  return found;
}

