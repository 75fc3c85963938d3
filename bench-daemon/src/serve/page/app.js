// The page: what it knows, what it asks for, and what the keys do.
"use strict";

import { Refused, file, get, listen, post, put, remove, signIn, signOut, stopNow } from "./server.js";
import {
  $,
  drawInstruments,
  drawMissed,
  drawNow,
  drawOthers,
  drawOverview,
  drawRun,
  drawStop,
  drawTrip,
  duration,
  el,
  fill,
  outcome,
  person,
  text,
  when,
} from "./bench.js";
import { tellHere } from "./notices.js";
import { drawTime, fitTime } from "./time.js";
import { drawTour, noteTour } from "./tour.js";

const known = {
  benches: new Map(),
  bench: "",
  scopes: [],
  queue: { items: [], held: {} },
  runs: [],
  spectra: new Map(),
  models: new Map(),
  chosen: [],
  missed: [],
};

const may = (scope) => known.scopes.includes(scope);
const live = () => known.benches.get(known.bench);

let silence = 0;

function say(words, bad) {
  clearTimeout(silence);
  if (words && !bad) silence = setTimeout(() => say(""), 10000);
  $("said").hidden = !words;
  $("said").className = `banner ${bad ? "bad" : "note"}`;
  text($("said"), words || "");
}

// Does something that the server may refuse, and says so.
async function attempt(work, done) {
  try {
    const result = await work();
    say(done ? done(result) : "");
    return result;
  } catch (error) {
    say(error instanceof Refused ? `Refused: ${error.message}` : `Not reached: ${error.message}`, true);
    return null;
  }
}

// What a stop has to say stays until a person has read it, or a stop has gone well.
function stopSays(words, bad = true) {
  const banner = $("stopsaid");
  banner.hidden = !words;
  if (!words) return;
  banner.className = `banner ${bad ? "bad" : "fine"}`;
  const close = el("button", { type: "button", onclick: () => stopSays("") }, "Close this message");
  banner.replaceChildren(el("strong", {}, words), " ", close);
}

// Of several benches each by its name, the worst first; the banner of the shown one has the rest.
function tellStops(reports) {
  if (reports.length < 2 && known.bench) return stopSays("");
  const fine = (report) => report.verified || report.simulated;
  const words = (report) =>
    report.verified
      ? `${report.bench}: every output is off, read back`
      : report.simulated
        ? `${report.bench}: simulated within the run's process, which has ended`
        : `▲ ${report.bench}: STOPPED, BUT NOT VERIFIED: LOOK AT THE BENCH`;
  const sorted = [...reports].sort((a, b) => Number(fine(a)) - Number(fine(b)));
  return stopSays(`Stopped. ${sorted.map(words).join("; ")}.`, !reports.every(fine));
}

// ---- the stop -----------------------------------------------------------------------------------

// Stops the bench that is shown, or all of them. A request that hangs is given up after some
// seconds and sent again: the server does a stop once, and tells everybody who asks meanwhile how
// it went.
async function stop(all) {
  const button = $(all ? "stopall" : "stop");
  button.classList.add("pressed");
  // Who stops before it is known which bench is meant, means all of them.
  const one = all ? "" : known.bench;
  const began = Date.now();
  for (let tries = 1; ; tries += 1) {
    text(button, tries === 1 ? "■ STOPPING …" : `■ STOPPING, TRY ${tries} …`);
    try {
      const reports = one ? [await stopNow(`/benches/${one}/stop`)] : await stopNow("/stop");
      reports.forEach(stopped);
      tellStops(reports);
      miss(reports);
      break;
    } catch (error) {
      const waited = Math.round((Date.now() - began) / 1000);
      if (error instanceof Refused && (error.status === 401 || error.status === 403)) {
        stopSays(
          `The stop was refused: sign in first (${error.message}). ` +
            "Without a token: the emergency switch, or on the machine: eis-bench safe",
        );
        break;
      }
      if (error instanceof Refused && error.status < 500 && error.status !== 429) {
        stopSays(
          `The stop was refused: ${error.message}. NOTHING WAS STOPPED, and it is not sent again. ` +
            "Use the emergency switch, or on the machine: eis-bench safe",
        );
        break;
      }
      const why = error.name === "TimeoutError" ? "no answer yet" : error.message;
      stopSays(
        `No word after ${waited} s that the bench is off (${why}). The stop is sent again. ` +
          "Use the emergency switch, or on the machine: eis-bench safe",
      );
      if (error.name !== "TimeoutError") await new Promise((done) => setTimeout(done, 500));
    }
  }
  button.classList.remove("pressed");
  text(button, stopLabel(all));
}

// Where there are several benches, the button says which one it stops.
function stopLabel(all) {
  if (all || !known.bench) return "■ STOP ALL";
  return known.benches.size > 1 ? `■ STOP ${known.bench}` : "■ STOP";
}

// On such a bench a current may flow.
const loud = (bench) =>
  bench.state === "running" || bench.state === "unknown" || (bench.state === "latched" && !bench.verified);

// Benches that are as they were after a stop of another one.
function miss(reports) {
  const off = new Set(reports.map((report) => report.bench));
  known.missed = [...known.benches.values()]
    .filter((bench) => !off.has(bench.bench) && loud(bench))
    .map((bench) => bench.bench);
  drawMiss();
}

function drawMiss() {
  known.missed = known.missed.filter((name) => known.benches.has(name) && loud(known.benches.get(name)));
  drawMissed(
    known.missed.map((name) => known.benches.get(name)),
    () => {
      known.missed = [];
      drawMiss();
    },
  );
}

function stopped(report) {
  if (report.bench !== known.bench || $("stopped").dataset.gone === String(report.unix_s)) return;
  drawStop(report);
}

let escaped = 0;
document.addEventListener("keydown", (event) => {
  if (event.repeat) return;
  const typing = /^(INPUT|SELECT|TEXTAREA)$/.test(event.target.tagName);
  if (event.key === "Escape") {
    const again = event.timeStamp - escaped < 1500;
    escaped = again ? 0 : event.timeStamp;
    if (again) stop(false);
    else say(`Esc once more within 1.5 s: ${stopLabel(false)}`);
  } else if (event.key === "S" && event.shiftKey && !event.ctrlKey && !event.altKey && !event.metaKey && !typing) {
    stop(false);
  }
});

// ---- spectra ------------------------------------------------------------------------------------

async function load(run) {
  const found = await get(`/runs/${run}/spectra`);
  known.spectra.set(run, new Map(found.map((one) => [one.name, one])));
}

// What a sweep is called in words: `raw_fake_cell` is the fake cell.
const named = (name) => name.replace(/^raw_/, "").replaceAll("_", " ");

// Of a run its corrected spectra, or, while it has none, the sweep that grows.
function shown(run) {
  const all = [...(known.spectra.get(run) || new Map()).values()];
  const corrected = all.filter((one) => one.corrected);
  return corrected.length ? corrected : all;
}

// Of the curves of one run, by the place of their marks and colours.
const LOOKS = ["spectrum", "shunt", "fake cell", "short"];

function curves() {
  const runs = known.chosen.length ? known.chosen : [live() && live().run && live().run.run].filter(Boolean);
  const found = [];
  for (const run of runs)
    for (const one of shown(run))
      found.push({
        id: `${run} ${one.name}`,
        run,
        file: one.name,
        name: runs.length > 1 ? `${run}: ${named(one.name)}` : named(one.name),
        points: one.points,
        corrected: one.corrected,
      });
  // A control looks the same whether it grows or was measured before: by its name, not by its place.
  const looks = (one, place) => (runs.length > 1 ? place : Math.max(0, LOOKS.indexOf(one.name)));
  return found.slice(0, 25).map((one, place) => ({ ...one, index: looks(one, place) }));
}

// Fitted models by curve; asked for once for as many points as there are.
async function askModels(found) {
  const wanted = found.filter((one) => one.corrected && named(one.file).startsWith("spectrum"));
  for (const one of wanted.slice(0, 4)) {
    const key = `${one.id} ${one.points.length}`;
    if (known.models.has(key)) continue;
    known.models.set(key, []);
    const models = await get(`/runs/${one.run}/models?spectrum=${encodeURIComponent(one.file)}`).catch(() => []);
    known.models.set(
      key,
      models.map((model) => ({ ...model, curve: one.id })),
    );
    if (models.length) drawSpectra();
  }
}

let panel = null;

function drawSpectra() {
  const found = curves();
  $("plots").hidden = !found.length;
  if (!found.length || $("main").hidden) return;
  const onPoint = (curve, point) => {
    const query = new URLSearchParams({ spectrum: curve.file, freq_hz: point.freq_hz });
    go(`#/run/${encodeURIComponent(curve.run)}?${query}`);
  };
  panel ||= window.eisCurves.panel($("curves"), { onPoint });
  const models = found.flatMap((one) => known.models.get(`${one.id} ${one.points.length}`) || []);
  panel.show({ curves: found, models, controls: [] });
  askModels(found);
}

// ---- time ---------------------------------------------------------------------------------------

// No more often than this while readings come in, ms.
const TIME_MS = 2000;
let timed = 0;

function drawStrips(now) {
  const at = Date.now();
  if (!now && at - timed < TIME_MS) return;
  timed = at;
  const bench = live();
  const run = known.chosen.length === 1 ? known.chosen[0] : bench && bench.run && bench.run.run;
  drawTime(get, run || "", bench ? bench.limits : []);
}

// ---- queue and history --------------------------------------------------------------------------

function drawQueue() {
  const items = known.queue.items;
  const waiting = items.filter((item) => !item.process);
  const move = (item) => post("/queue/order", { ids: [item.id] });
  fill(
    $("items"),
    ...(items.length ? items : [null]).map((item) => {
      if (!item) return el("li", { class: "quiet" }, "Empty.");
      const words =
        `${item.run} on ${item.bench}, ${item.kind === "resume" ? "to go on, " : ""}` +
        `about ${duration(item.expected_s)} of bench time, by ${person(item.by)}`;
      const cancel =
        !item.process && may("operate")
          ? el(
              "button",
              {
                type: "button",
                onclick: () =>
                  attempt(
                    () => remove(`/queue/${item.id}`),
                    () => `${item.run} was taken out.`,
                  ),
              },
              "Take out",
            )
          : null;
      const first =
        cancel && waiting[0] !== item
          ? el("button", { type: "button", onclick: () => attempt(() => move(item)) }, "First")
          : null;
      return el("li", {}, item.process ? el("b", {}, "▶ in work: ") : "", words, " ", first, cancel);
    }),
  );
  const why = known.queue.held[known.bench];
  $("held").hidden = !why;
  if (why) {
    const reason = el("input", { id: "why", maxlength: 200, required: true, autocomplete: "off" });
    const release = el(
      "form",
      {
        class: "acts",
        onsubmit: (event) => {
          event.preventDefault();
          attempt(
            () => post(`/benches/${known.bench}/release`, { why: $("why").value.trim() }),
            () => "The queue goes on.",
          );
        },
      },
      el("label", {}, "What was found, and why it may go on ", reason),
      el("button", { type: "submit", disabled: !may("energise") }, "Let the queue go on"),
      may("energise") ? "" : el("span", { class: "quiet" }, lacks("energise")),
    );
    // Drawn anew only where it says something else: what is typed stays.
    const words = `❚❚ Nothing is begun on ${known.bench}: ${why}. `;
    if ($("held").dataset.words !== words) $("held").replaceChildren(words, release);
    $("held").dataset.words = words;
  }
}

function drawHistory() {
  const row = (job) => {
    const run = job.item.run;
    const how = !job.ended ? "▶ in work" : outcome(job.ended);
    const box = el("input", {
      type: "checkbox",
      "aria-label": `Compare ${run}`,
      checked: known.chosen.includes(run),
      onchange: (event) => compare(run, event.target.checked),
    });
    const acts = [];
    if (job.ended && job.ended.finished)
      acts.push(el("button", { type: "button", onclick: () => keep(run, "report.html") }, "Report"));
    if (job.ended && !job.ended.finished && may("energise"))
      acts.push(
        el(
          "button",
          {
            type: "button",
            onclick: () =>
              attempt(
                () => post(`/runs/${run}/resume`),
                () => `${run} waits to go on.`,
              ),
          },
          "Go on",
        ),
      );
    return el(
      "tr",
      {},
      el("td", { "data-name": "Compare" }, box),
      el("th", { scope: "row" }, el("a", { href: `#/run/${encodeURIComponent(run)}` }, run)),
      el("td", { "data-name": "Bench" }, job.item.bench),
      el("td", { "data-name": "Submitted" }, when(job.item.submitted_unix_s)),
      el("td", { "data-name": "By" }, person(job.item.by)),
      el("td", {}, how),
      el("td", {}, ...acts),
    );
  };
  fill($("runs"), ...known.runs.slice(0, 20).map(row));
  drawTour(known.runs);
}

async function compare(run, on) {
  known.chosen = known.chosen.filter((one) => one !== run);
  if (on) known.chosen.push(run);
  if (on && !known.spectra.has(run)) await attempt(() => load(run));
  drawSpectra();
  drawStrips(true);
}

// A file of a run, saved by the browser: it never becomes a page of this server.
async function keep(run, path) {
  const blob = await attempt(() => file(`/runs/${run}/files/${path}`));
  if (!blob) return;
  const link = el("a", { href: URL.createObjectURL(blob), download: `${run}-${path}` });
  document.body.append(link);
  link.click();
  link.remove();
}

function drawActs() {
  const run = live() && live().run;
  const acts = [];
  if (run && run.going && run.run && run.time !== "virtual") {
    if (live().state === "paused" && may("energise"))
      acts.push(
        el(
          "button",
          {
            type: "button",
            onclick: () =>
              attempt(
                () => post(`/runs/${run.run}/go-on`),
                (r) => r.said,
              ),
          },
          "Go on",
        ),
      );
    else if (live().state === "running" && may("operate"))
      acts.push(
        el(
          "button",
          {
            type: "button",
            onclick: () =>
              attempt(
                () => post(`/runs/${run.run}/pause`),
                (r) => r.said,
              ),
          },
          "Pause after this step",
        ),
      );
  }
  const key = acts.map((act) => act.textContent).join();
  if ($("runacts").dataset.key !== key) $("runacts").replaceChildren(...acts);
  $("runacts").dataset.key = key;
}

// ---- the whole ----------------------------------------------------------------------------------

function draw() {
  const now = live();
  if (!now) return;
  const sign = now.state === "latched" ? "▲ " : now.state === "running" ? "▶ " : "";
  if (!$("main").hidden) document.title = `${sign}${now.bench} – eis-bench`;
  drawNow(now);
  drawRun(
    now,
    known.runs.find((job) => now.run && job.item.run === now.run.run),
    $("runbody"),
  );
  drawActs();
  drawInstruments(now);
  drawOverview([...known.benches.values()], known.bench);
  if (!$("stop").classList.contains("pressed")) text($("stop"), stopLabel(false));
  drawOthers(
    [...known.benches.values()].filter((one) => one.bench !== known.bench),
    choose,
  );
  drawMiss();
  const clear = (one, found) =>
    attempt(
      () => post(`/benches/${one.bench}/trips/clear`, { cause: one.trip.cause, found }),
      () => `${one.bench} is cleared.`,
    );
  drawTrip(now, clear, may("clear-trip") ? "" : lacks("clear-trip"));
  // What a stop has shown is no longer so once something runs again, or has tripped since.
  const over =
    now.state === "running" || now.state === "paused" || (now.trip && now.stop && now.trip.unix_s > now.stop.unix_s);
  if (over) $("stopped").hidden = true;
  else if (now.stop) stopped(now.stop);
  drawRights();
}

// What one may not do is shown, and why.
function drawRights() {
  $("identify").disabled = !may("operate");
  $("identify").title = may("operate") ? "" : lacks("operate");
  for (const control of $("submit").querySelectorAll("button[type=submit]")) control.disabled = !may("energise");
  $("maynot").hidden = may("energise");
  text($("maynot"), may("energise") ? "" : `To submit, the token ${lacks("energise")}.`);
}

const lacks = (scope) => `needs the scope ${scope}; yours has: ${known.scopes.join(", ") || "none"}`;

// ---- parts of the page --------------------------------------------------------------------------

const MODULES = {
  new: "/forms.js",
  files: "/forms.js",
  runs: "/find.js",
  cells: "/find.js",
  run: "/run.js",
  cell: "/cell.js",
  analyses: "/analysis.js",
  analysis: "/analysis.js",
  pack: "/pack.js",
  notices: "/notices.js",
};

const context = {
  get,
  post,
  put,
  remove,
  file,
  attempt,
  may,
  Refused,
  go: (hash) => go(hash),
  benches: () => [...known.benches.keys()],
  bench: () => known.bench,
  // Whoever looks at a run that goes means its bench, when they stop.
  watch: (bench) => {
    if (!known.benches.has(bench)) return;
    known.bench = bench;
    draw();
  },
};

const view = { module: null, opened: 0 };

function go(hash) {
  if (location.hash === hash) route();
  else location.hash = hash;
}

// What the address names: `#/run/demo-3?…` a part, anything else a bench.
function address() {
  const [path, query] = location.hash.slice(2).split("?");
  return { path: path.split("/").map(plain), query: new URLSearchParams(query || "") };
}

async function route() {
  if (!$("login").hidden || !may("read")) return;
  const opened = (view.opened += 1);
  noteTour();
  if (view.module && view.module.close) view.module.close();
  view.module = null;
  const part = location.hash.startsWith("#/") ? address() : null;
  const source = part && Object.hasOwn(MODULES, part.path[0]) && MODULES[part.path[0]];
  $("main").hidden = Boolean(source);
  $("view").hidden = !source;
  $("view").replaceChildren();
  for (const link of $("views").querySelectorAll("a"))
    if (source && link.hash.slice(2) === part.path[0]) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  if (!source) {
    if (known.benches.has(addressed())) known.bench = addressed();
    $("stopped").hidden = true;
    await attempt(refresh);
    // Whoever comes from another part begins at the top of this one.
    if (opened > 1) $("now-h").focus({ preventScroll: true });
    return;
  }
  const parent = el("div", { class: "view" });
  try {
    const module = await import(source);
    if (opened !== view.opened) return;
    view.module = module;
    $("view").append(parent);
    await module.open(parent, part, context);
  } catch (error) {
    say(error instanceof Refused ? `Refused: ${error.message}` : `Not reached: ${error.message}`, true);
    return;
  }
  const heading = parent.querySelector("h2");
  if (heading && opened === view.opened) document.title = `${heading.textContent} – eis-bench`;
}

// The bench that the address names: `#demo`.
const addressed = () => (location.hash.startsWith("#/") ? "" : plain(location.hash.slice(1)));

// An address that is broken names nothing.
function plain(part) {
  try {
    return decodeURIComponent(part);
  } catch {
    return "";
  }
}

// Shows another bench; each has an address of its own, which can be sent.
const choose = (bench) => go(`#${encodeURIComponent(bench)}`);

async function refresh() {
  const [benches, queue, runs, offered] = await Promise.all([
    get("/benches"),
    get("/queue"),
    get("/runs"),
    get("/experiments"),
  ]);
  known.benches = new Map(benches.map((one) => [one.bench, one]));
  if (known.benches.has(addressed())) known.bench = addressed();
  if (!known.benches.has(known.bench))
    known.bench = (benches.find((one) => one.run && one.run.going) || benches[0]).bench;
  [known.queue, known.runs] = [queue, runs];
  $("stopall").hidden = benches.length < 2;
  const before = $("experiment").value;
  const names = offered.map((one) => one.experiment);
  if (names.join() !== [...$("experiment").options].map((one) => one.value).join()) {
    $("experiment").replaceChildren(...names.map((name) => el("option", {}, name)));
    // What was chosen stays chosen; nothing else chooses.
    $("experiment").value = names.includes(before) ? before : names[0] || "";
  }
  known.spectra.clear();
  const wanted = new Set(known.chosen);
  if (live().run && live().run.run) wanted.add(live().run.run);
  await Promise.all([...wanted].map((run) => load(run).catch(() => {})));
  draw();
  drawQueue();
  drawHistory();
  drawSpectra();
  drawStrips(true);
}

// After a while without the server: somebody else may have signed in, and a part may not have come.
async function again() {
  const who = await attempt(() => get("/whoami"));
  if (who && (who.name !== known.who || who.scopes.join() !== known.scopes.join())) location.reload();
  await attempt(refresh);
  if (!view.module && location.hash.startsWith("#/")) route();
}

function heard(kind, data) {
  if (view.module && view.module.heard) view.module.heard(kind, data);
  if (kind === "hello") again();
  if (kind === "lost") attempt(refresh);
  if (kind === "live") {
    const before = known.benches.get(data.bench);
    known.benches.set(data.bench, data);
    draw();
    if (data.bench === known.bench && before && (before.run && before.run.run) !== (data.run && data.run.run))
      drawSpectra();
    if (data.bench === known.bench) drawStrips(false);
  }
  if (kind === "notice") tellHere(data);
  if (kind === "stop") stopped(data);
  if (kind === "queue") {
    known.queue = data;
    drawQueue();
  }
  if (kind === "run") {
    known.runs = [data, ...known.runs.filter((job) => job.item.run !== data.item.run)];
    drawHistory();
    draw();
  }
  if (kind === "spectrum" && data.run) {
    if (!known.spectra.has(data.run)) known.spectra.set(data.run, new Map());
    known.spectra.get(data.run).set(data.spectrum.name, data.spectrum);
    drawSpectra();
  }
}

function link(state) {
  const words = {
    up: "● connected",
    down: "○ connection lost: what is shown is old",
    refused: "✕ the token is refused",
  };
  text($("link"), words[state]);
  $("link").className = `chip ${state}`;
  document.body.classList.toggle("stale", state !== "up");
  if (state === "refused") login("The session has ended.");
}

function login(words) {
  $("login").hidden = false;
  $("main").hidden = $("view").hidden = $("views").hidden = true;
  text($("loginsaid"), words || "");
  $("token").focus();
}

async function begin() {
  try {
    const who = await get("/whoami");
    known.scopes = who.scopes;
    known.bench ||= who.benches.length === 1 ? who.benches[0] : "";
    known.who = who.name;
    $("leave").hidden = $("who").hidden = who.name === "local";
    text($("who"), `${who.name}: ${who.scopes.join(", ") || "STOP only"}`);
  } catch (error) {
    if (error instanceof Refused && (error.status === 401 || error.status === 403))
      return login("");
    text($("link"), "○ not reached, trying again");
    setTimeout(begin, 1000);
    return;
  }
  $("login").hidden = true;
  if (!may("read")) {
    text($("link"), "● this token shows nothing; STOP works");
    return;
  }
  $("views").hidden = false;
  // A part of the page may ask which benches there are.
  await attempt(refresh);
  listen(known.who, heard, link);
  await route();
}

$("stop").addEventListener("click", () => stop(false));
$("stopall").addEventListener("click", () => stop(true));
window.addEventListener("resize", () => {
  fitTime();
  drawStrips(true);
});
$("skip").addEventListener("click", () => ($("main").hidden ? $("view") : $("main")).focus());
$("leave").addEventListener("click", async () => {
  await attempt(signOut);
  location.reload();
});
window.addEventListener("hashchange", route);
// A plan belongs to what it was made for.
$("experiment").addEventListener("change", () => ($("plan").hidden = true));
$("login").addEventListener("submit", async (event) => {
  event.preventDefault();
  const token = $("token").value.trim();
  $("token").value = "";
  try {
    await signIn(token);
  } catch (error) {
    return login(error.message);
  }
  return begin();
});
$("identify").addEventListener("click", () =>
  attempt(
    () => post(`/benches/${known.bench}/identify`),
    (found) => found.trouble || `${found.answers.length} instruments answered.`,
  ),
);
$("submit").addEventListener("submit", (event) => {
  event.preventDefault();
  const body = { experiment: $("experiment").value, bench: known.bench };
  if ($("seed").value !== "") body.seed = Number($("seed").value);
  attempt(
    () => post("/queue", body),
    (item) => `${item.run} is in the queue.`,
  );
});
$("showplan").addEventListener("click", async () => {
  const plan = await attempt(() => get(`/experiments/${$("experiment").value}/plan?bench=${known.bench}`));
  $("plan").hidden = !plan;
  if (!plan) return;
  const stages = plan.stages.map((stage) =>
    el(
      "li",
      {},
      `${stage.purpose}, about ${duration(stage.expected_s)}`,
      el("ol", {}, ...stage.steps.map((step) => el("li", {}, step))),
    ),
  );
  $("plan").replaceChildren(
    el(
      "p",
      {},
      `${plan.experiment} on ${plan.bench}: about ${duration(plan.expected_s)} of bench time, ` +
        `at most ${duration(plan.longest_s)}.`,
    ),
    el("ol", {}, ...stages),
  );
});

begin();
