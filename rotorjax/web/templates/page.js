"use strict";
// Files in, progress and report out. Whatever comes from files is shown as text, never as HTML.

const EVERY_MS = 400;
const CANCELLED = "Cancelled; nothing was kept.";
const at = (id) => document.getElementById(id);
let chosen = [];
let shown = null; // the explanation whose result is on the page
let watching = false;
let sending = null; // how to stop it, while files are sent
let followed = null; // the explanation that was seen to go on

const made = (tag, text, className) => {
  const element = document.createElement(tag);
  element.textContent = text;
  if (className) element.className = className;
  return element;
};
const isRig = (name) => name.toLowerCase().endsWith(".toml");
const size = (bytes) => {
  if (bytes < 1e5) return `${Math.ceil(bytes / 1e3)} kB`;
  return `${bytes < 1e8 ? (bytes / 1e6).toPrecision(3) : Math.round(bytes / 1e6)} MB`;
};

// What is to be explained

function add(files) {
  for (const file of files) chosen = [...chosen.filter((other) => other.name !== file.name), file];
  list();
  say([]);
}

function list() {
  at("chosen").replaceChildren(...chosen.map((file) => {
    const item = made("li", "");
    const remove = made("button", "Remove", "second");
    remove.type = "button";
    remove.setAttribute("aria-label", `remove ${file.name}`);
    remove.addEventListener("click", () => {
      chosen = chosen.filter((other) => other !== file);
      list();
      at("files").focus();
    });
    const kind = isRig(file.name) ? "rig file" : "measured";
    item.append(made("span", file.name, "name"), made("span", `${kind}, ${size(file.size)}`, "kind"), remove);
    return item;
  }));
  enable();
}

function enable(busy = watching) {
  at("explain").disabled = busy || chosen.length === 0;
  at("example").disabled = busy;
}

function say(problems) {
  const located = (line) => (/^[^ ]+\.\w+:/.test(line) ? "where" : "");
  at("problems").replaceChildren(...problems.map((line) => made("p", line, located(line))));
}

// Folders that are dropped are looked through.
async function filesOf(entry) {
  if (entry.isFile) return [await new Promise((found, failed) => entry.file(found, failed))];
  const reader = entry.createReader();
  const inside = [];
  for (;;) {
    const some = await new Promise((found, failed) => reader.readEntries(found, failed));
    if (some.length === 0) break;
    for (const each of some) if (!each.name.startsWith(".")) inside.push(...(await filesOf(each)));
  }
  return inside;
}

async function dropped(event) {
  event.preventDefault();
  at("drop").classList.remove("over");
  const items = [...event.dataTransfer.items].map((item) => item.webkitGetAsEntry && item.webkitGetAsEntry());
  if (!items.some((entry) => entry && entry.isDirectory)) {
    add([...event.dataTransfer.files]);
    return;
  }
  for (const entry of items.filter(Boolean)) add(await filesOf(entry));
}

// Asking

async function ask(path, options) {
  try {
    const answer = await fetch(path, options);
    const content = await answer.json();
    return answer.ok ? content : { problems: content.problems, refused: true };
  } catch (error) {
    if (error.name === "AbortError") return { problems: [CANCELLED], refused: true };
    const cure = "start rotorjax serve again, then reload this page";
    return { problems: [`The server does not answer any more: ${cure}.`], refused: true, gone: true };
  }
}

async function begin(path, body) {
  say([]);
  enable(true);
  showProgress({ elapsed_s: 0, files: [], stages: [{ stage: "sending the files" }], line: "", limit: null });
  sending = new AbortController();
  const answer = await ask(path, { method: "POST", body, signal: sending.signal });
  sending = null;
  if (answer.refused) {
    enable(false);
    at("progress").hidden = true;
    say(answer.problems);
    // What was there before stays; one that another window has begun can be watched, and cancelled.
    if (!answer.gone) watch(true);
    return;
  }
  watch();
}

// Until the explanation has ended. What was refused or cancelled before the page was loaded is not shown again.
async function watch(loaded = false) {
  watching = true;
  enable();
  for (;;) {
    const job = await ask("job");
    if (loaded && !["running", "done"].includes(job.state) && !job.refused) break;
    loaded = false;
    if (job.refused) {
      say(job.problems);
      at("progress").hidden = true;
      break;
    }
    show(job);
    if (job.state !== "running") break;
    await new Promise((go) => setTimeout(go, EVERY_MS));
  }
  watching = false;
  enable();
}

// Showing

function show(job) {
  if (job.state === "none") return;
  at("progress").hidden = true;
  if (job.state === "running") showProgress(job);
  else if (job.state === "done") showResult(job);
  else {
    at("result").hidden = true;
    say(job.state === "cancelled" ? [CANCELLED] : job.problems);
  }
}

function showProgress(job) {
  followed = job.id;
  at("progress").hidden = false;
  at("result").hidden = true;
  at("elapsed").textContent = `${Math.round(job.elapsed_s)} s`;
  const more = job.files.length - 3;
  const files = job.files.slice(0, 3).join(", ") + (more > 0 ? ` and ${more} more` : "");
  const now = job.stages.length ? job.stages[job.stages.length - 1].stage : "loading";
  at("of-what").textContent = job.line.startsWith("reading") && job.line !== now ? job.line : files;
  // Said once for each stage: what is renewed is read out again.
  if (at("stage").textContent !== now) at("stage").textContent = now;
  at("spent").hidden = job.limit === null;
  if (job.limit !== null) {
    at("share").max = job.limit;
    at("share").value = job.spent;
    const share = ((100 * job.spent) / job.limit).toFixed(0);
    const numbers = `${job.spent.toLocaleString("en")} of ${job.limit.toLocaleString("en")}`;
    at("share-told").textContent = `${numbers} linearisations, ${share} % of the limit; most explanations take far less`;
  }
  at("stages").replaceChildren(...job.stages.slice(0, -1).reverse().map(({ at_s, stage }) => {
    const item = made("li", "");
    item.append(made("span", `${Math.round(at_s)} s`, "at"), made("span", stage));
    return item;
  }));
}

function showResult(job) {
  at("result").hidden = false;
  if (shown === job.id) return;
  shown = job.id;
  at("verdict").textContent = job.verdict;
  at("verdict").className = `badge ${job.verdict.replaceAll(" ", "-")}`;
  at("took").textContent = `${job.files.join(", ")}: ${Math.round(job.elapsed_s)} s`;
  at("notes").replaceChildren(...job.notes.map((note) => made("li", note)));
  const results = `jobs/${job.id}`;
  at("save-report").href = at("open-report").href = at("report").src = `${results}/report.html`;
  at("save-rig").href = `${results}/explained.toml`;
  at("save-json").href = `${results}/explanation.json`;
  if (followed === job.id) at("result-head").focus();
}

// The report is as high as it is, so that one thing scrolls.
function fit() {
  const page = at("report").contentDocument;
  if (page && page.body) at("report").style.height = `${page.documentElement.offsetHeight + 8}px`;
}
at("report").addEventListener("load", () => {
  const page = at("report").contentDocument;
  if (page && page.body) new ResizeObserver(fit).observe(page.body);
  fit();
});

at("files").addEventListener("change", () => {
  add([...at("files").files]);
  at("files").value = "";
});
for (const name of ["dragenter", "dragover"]) {
  document.addEventListener(name, (event) => {
    event.preventDefault();
    at("drop").classList.add("over");
  });
}
document.addEventListener("dragleave", (event) => {
  if (!event.relatedTarget) at("drop").classList.remove("over");
});
document.addEventListener("drop", dropped);
at("given").addEventListener("submit", (event) => {
  event.preventDefault();
  const total = chosen.reduce((sum, file) => sum + file.size, 0);
  const { mostBytes, tableMb, recordingsMb } = document.body.dataset;
  if (total > Number(mostBytes)) {
    const most = `tables have at most ${tableMb} MB, recordings ${recordingsMb} MB together`;
    say([`The files have ${size(total)}; ${most}. rotorjax serve --max-table-mb, --max-recordings-mb allow more.`]);
    return;
  }
  const form = new FormData();
  for (const file of chosen) form.append("files", file, file.name);
  begin("explain", form);
});
at("example").addEventListener("click", () => begin("example"));
at("cancel").addEventListener("click", () => {
  if (sending) sending.abort();
  ask("cancel", { method: "POST" });
});
list();
watch(true);
