// Every bench of every server of the fleet, its jobs, and the actions on them. Rows keep their nodes while their text
// changes, so that focus, scroll position and a press of a button survive.
"use strict";

import { $, duration, el, fill, person, text, when } from "./bench.js";
import { begin, cell, lack, table } from "./find.js";

const WORDS = {
  title: "Fleet",
  named: (fleet) => `Fleet ${fleet}`,
  looking: "Looking …",
  connected: (server) => `● Connected to ${server}.`,
  apart: (server) =>
    `▲ NOT connected to ${server}: what is shown of other benches is old. Benches go on by themselves.`,
  old: (ago, why) => `▲ This is ${ago} old: the server does not answer (${why}).`,
  unknown: "–",
  name: (one) => `${one.site}/${one.bench}`,
  benches: "Benches",
  benchesShown: (shown, all) => `${shown} of ${all} ${all === 1 ? "bench" : "benches"} shown.`,
  benchesCut: (most) => ` Only the first ${most} are drawn: narrow it by text or state.`,
  noBench: "No bench has registered.",
  find: "Site, bench, job or run",
  state: "State",
  all: "all",
  loud: "needs a person",
  states: {
    idle: ["○", "idle"],
    running: ["▶", "running: current may flow"],
    held: ["❚❚", "held"],
    draining: ["▽", "draining"],
    latched: ["▲", "latched: a person has to look"],
    asking: ["◆", "waits for a person"],
    silent: ["?", "silent: nothing is known of it"],
  },
  sign: (sign, words) => `${sign} ${words}`,
  counted: (n, words) => `${words} (${n})`,
  columns: {
    bench: "Bench",
    state: "State",
    work: "In work",
    heard: "Last heard",
    outputs: "Outputs",
    can: "Can do",
    acts: "Stop and hold",
  },
  work: (job, run) => [job && `job ${job}`, run && `run ${run}`].filter(Boolean).join(", "),
  left: (time) => `about ${time} left`,
  lastKnown: (words) => `last known: ${words}`,
  nothing: "nothing",
  ago: (time) => `${time} ago`,
  outputs: { true: "✓ off, read back", false: "▲ NOT verified", null: "not read" },
  outputsSilent: "▲ not known now",
  current: (amps) => `${amps} A`,
  temperature: (low, high) => `${low} to ${high} °C`.replaceAll("-", "−"),
  simulated: "simulated",
  stop: "■ Stop",
  acts: { hold: "Hold …", drain: "Drain …", release: "Release …" },
  actOn: (act, name) => `${act}: ${name}`,
  asked: {
    hold: (name) => `Hold ${name}: nothing new is begun on it until it is released. A run in work goes on.`,
    drain: (name) => `Drain ${name}: it ends what it has begun, and takes no more work until it is released.`,
    release: (name) => `Release ${name}: it takes work again, and a current may flow. Look at the bench first.`,
  },
  go: { hold: "Hold it", drain: "Drain it", release: "Release it" },
  not: "Not now",
  why: "Why (it is kept with your name)",
  whyMissing: "Say why.",
  acted: {
    hold: (name) => `${name} is told to hold.`,
    drain: (name) => `${name} is told to drain.`,
    release: (name) => `${name} is released.`,
  },
  notDone: (why) => `✕ Refused: ${why}`,
  notKnown: (why) => `▲ No answer (${why}): it is NOT known whether it was done. Look before you do it again.`,
  stopWhy: "stopped on the page of the fleet",
  stopAll: "■ STOP FLEET",
  stopWaits: (waited) =>
    `The stop was sent; no word after ${waited} s that every bench is off. The table shows each as it is heard. ` +
    "A bench that does not answer: use its emergency switch, or on its machine: eis-bench safe",
  stopped: "Stop, bench by bench",
  stopOf: (off, n) => `${off} of ${n} ${n === 1 ? "bench" : "benches"} stopped with every output off, read back.`,
  stopSimulated: (n) => ` ${n} simulated within a run that has ended.`,
  stopUnverified: (n) => `▲ ${n} STOPPED, BUT NOT VERIFIED: LOOK AT THE BENCH. `,
  stopMissed: (why) => `▲ FURTHER BENCHES MAY NOT HAVE BEEN REACHED (${why}). Go there. `,
  stopUnreached: (n) => `▲ ${n} NOT REACHED: it is unknown whether anything was stopped there. Go there. `,
  stopOff: (name) => `✓ ${name}: stopped, every output is off, read back.`,
  stopSim: (name) => `✓ ${name}: it is simulated within the run's process, which has ended.`,
  stopNotVerified: (name) => `▲ ${name}: STOPPED, BUT NOT VERIFIED: LOOK AT THE BENCH.`,
  stopNotReached: (name) => `▲ ${name}: NOT REACHED. It is not known to be stopped: go there.`,
  stopNoWord: "the answer does not name it",
  stopFine: (n) => `${n} ${n === 1 ? "bench" : "benches"} off or simulated`,
  close: "Close this report",
  lost: "Runs that a person has to judge",
  lostHint:
    "These runs were begun on a bench that is silent now. It is unknown whether they have run, or still do. " +
    "They are begun nowhere else before a person says so. ",
  lostOf: (job) => `${job.name} (job ${job.job}) on ${job.bench || "–"}${job.run ? `, run ${job.run}` : ""}`,
  lostWarn:
    "If the run did go on there, it is measured twice: another cell may be charged or discharged on top of it, and " +
    "its result may come back later. Look at the bench, at its outputs and at its run folder first.",
  lostLooked: "I have looked at the bench: the run does not go on there, and it may be run again.",
  lostTick: "First tick that you have looked.",
  lostGo: "Put it back into the queue",
  lostDone: (job) => `${job} is in the queue again.`,
  lostMore: (n) => `${n} more are in the list of jobs below, under the state lost.`,
  jobs: "Jobs",
  jobStates: {
    queued: ["…", "queued"],
    claimed: ["◇", "claimed by a bench"],
    started: ["▶", "started"],
    done: ["✓", "done"],
    failed: ["✕", "failed"],
    cancelled: ["–", "cancelled"],
    lost: ["▲", "lost: a person has to judge"],
  },
  jobColumns: {
    job: "Job",
    state: "State",
    words: "Reason",
    needs: "Needs",
    bench: "Bench",
    run: "Run",
    submitted: "Submitted",
    by: "By",
    campaign: "Campaign",
    acts: "",
  },
  campaign: "Campaign",
  jobsShown: (first, last) => (last ? `Jobs ${first} to ${last}, in the order of the server.` : "No such job."),
  next: "Next",
  first: "First",
  cancel: "Cancel",
  cancelled: (job) => `${job} is cancelled.`,
  need: {
    current_a: (value) => `${value} A`,
    temperature_c: (value) => `${value} °C`,
    fixture: (value) => `fixture ${value}`,
    bench: (value) => `bench ${value}`,
    site: (value) => `site ${value}`,
  },
  anyBench: "any bench",
  submit: "Send an experiment to the fleet",
  experiment: "Experiment of this server",
  ownText: "a text of your own",
  file: "or a file of this computer",
  text: "Text of the experiment (TOML)",
  checkOn: "Check it against the bench of this server",
  check: "Check",
  checking: "Being checked …",
  checkHint:
    "The check is made on this server. The bench that takes the job checks it again, against its own cell and limits.",
  mistake: (one) => `▲ ${one.line ? `Line ${one.line}, ` : ""}${one.field ? `${one.field}: ` : ""}${one.message}`,
  notChecked: (why) => `✕ Not checked: ${why}`,
  plan: (expected, longest) => `✓ No mistake found. About ${expected}, ${longest} at most.`,
  margin: (one) =>
    `${one.quantity}: planned ${one.least} to ${one.greatest} ${one.unit}; ` +
    (one.isBeyond ? `▲ beyond the limit by ${one.margin} ${one.unit}` : `${one.margin} ${one.unit} left`),
  needs: "What the bench must be able to do",
  fields: {
    current_a: "Current, A",
    temperature_c: "Temperature, °C",
    fixture: "Fixture",
    site: "Site",
    bench: "Bench",
  },
  any: "any",
  count: "How often",
  seed: "Seed",
  seedHint: "as in the file",
  label: "Campaign (a word to find them by)",
  send: "Send …",
  reasons: {
    check: "It has to be checked first.",
    changed: "It was changed since the check: check it again.",
    count: "How often: a whole number from 1 to 1000.",
    number: "Current and temperature are numbers, and a current is above 0.",
    seed: "The seed is a whole number from 0 to 9007199254740991.",
  },
  confirm: (name, count) => `${name} is sent ${count === 1 ? "once" : `${count} times`}. A current will flow.`,
  confirmTime: (expected, count) => `About ${expected} each${count === 1 ? "" : `, on any bench that is free`}.`,
  fits: (n, all) => `${n} of ${all} benches can do it.`,
  fitsNone: "▲ No bench that is registered can do it: it would wait.",
  yes: "Yes, send it",
  sending: "Being sent …",
  sent: (jobs) => `✓ ${jobs.length} ${jobs.length === 1 ? "job is" : "jobs are"} in the queue of the fleet.`,
  refused: (why) => `✕ Not sent: ${why}`,
  noAnswer: (why) =>
    `▲ No answer (${why}): it is NOT known whether it was sent. Look at the jobs before it is sent again.`,
};

// Interval of requests, ms; jobs are requested at least this often.
const POLL_MS = 2000;
const JOBS_MS = 10000;
// Timeout after which a stop is sent again, ms: the server waits 120 s for a bench that is cut off, and replies for all
// benches together.
const STOP_MS = 150000;
const MOST_ROWS = 300;
const JOBS = 100;
const LOST = 20;
const MOST_COUNT = 1000;
const LOUD = ["latched", "asking", "silent"];
const NEEDS = Object.keys(WORDS.fields);

let view = null;
let ids = 0;

const id = (name) => `fl-${name}-${(ids += 1)}`;
const button = (words, onclick, more) => el("button", { type: "button", onclick, ...more }, words);
const isUnset = (value) => value === null || value === undefined || value === "";
const signed = ([sign, words]) => WORDS.sign(sign, words);
const stateOf = (state) => WORDS.states[state] || ["?", state];
const pathOf = ({ site, bench }, act) =>
  `/fleet/benches/${encodeURIComponent(site)}/${encodeURIComponent(bench)}/${act}`;

// ---- benches ------------------------------------------------------------------------------------

function canDo({ current_a, temperature_c, fixtures, simulated }) {
  return [
    isUnset(current_a) ? null : WORDS.current(current_a),
    temperature_c ? WORDS.temperature(...temperature_c) : null,
    ...(fixtures || []),
    simulated ? WORDS.simulated : null,
  ]
    .filter(Boolean)
    .join("; ");
}

function workOf(one) {
  const words = WORDS.work(one.job, one.run);
  if (!words) return WORDS.nothing;
  if (one.state === "silent") return WORDS.lastKnown(words);
  return isUnset(one.left_s) ? words : `${words}; ${WORDS.left(duration(one.left_s))}`;
}

const isOff = (one) => one.outputs_verified === true && one.state !== "silent";

// Returns a row of a bench; `update(bench)` sets its text to the present state.
function benchRow(first) {
  const heads = WORDS.columns;
  const name = WORDS.name(first);
  const parts = Object.fromEntries(
    ["state", "held", "work", "heard", "outputs", "can"].map((k) => [k, el("span", {})]),
  );
  parts.held.className = "fl-why";
  const row = { bench: first };
  const act = (kind) =>
    button(WORDS.acts[kind], () => askWhy(row, kind), { "aria-label": WORDS.actOn(WORDS.acts[kind], name) });
  const acts = { hold: act("hold"), drain: act("drain"), release: act("release") };
  const stop = button(WORDS.stop, (event) => stopBench(row.bench, event.currentTarget), {
    class: "fl-stop",
    "aria-label": WORDS.actOn(WORDS.stop, name),
  });
  row.node = el(
    "tr",
    {},
    el("th", { scope: "row" }, el("div", { class: "fd-name" }, name)),
    cell(heads.state, parts.state, parts.held),
    cell(heads.work, parts.work),
    cell(heads.heard, parts.heard),
    cell(heads.outputs, parts.outputs),
    cell(heads.can, parts.can),
    cell(heads.acts, el("div", { class: "fl-acts" }, stop, ...Object.values(acts))),
  );
  row.update = (one) => {
    row.bench = one;
    text(parts.state, signed(stateOf(one.state)));
    parts.state.className = `fl-state fl-${Object.hasOwn(WORDS.states, one.state) ? one.state : "silent"}`;
    text(parts.held, one.held || "");
    text(parts.work, workOf(one));
    text(parts.heard, isUnset(one.silent_s) ? WORDS.unknown : WORDS.ago(duration(one.silent_s)));
    text(parts.outputs, one.state === "silent" ? WORDS.outputsSilent : WORDS.outputs[one.outputs_verified ?? null]);
    parts.outputs.className = isOff(one)
      ? "good"
      : one.outputs_verified === false || one.state === "silent"
        ? "bad"
        : "";
    text(parts.can, canDo(one.capabilities || {}));
    const isHeld = ["held", "draining"].includes(one.state) || !isUnset(one.held);
    acts.hold.hidden = acts.drain.hidden = isHeld;
    // A running bench may also be draining, which its state does not show.
    acts.release.hidden = !isHeld && one.state === "idle";
    for (const node of Object.values(acts)) node.disabled = Boolean(lack(view.ctx, "energise"));
  };
  row.update(first);
  return row;
}

function benchesShown() {
  const words = view.find.value.trim().toLowerCase().split(/\s+/);
  const wanted = view.state.value;
  const isMeant = (one) =>
    (!wanted || (wanted === "loud" ? LOUD.includes(one.state) : one.state === wanted)) &&
    words.every((word) => `${WORDS.name(one)} ${one.job || ""} ${one.run || ""}`.toLowerCase().includes(word));
  return view.fleet.benches.filter(isMeant);
}

// The order is that of the names and never of the states: no row moves under a finger.
function drawBenches() {
  const all = view.fleet.benches;
  const found = benchesShown();
  const shown = found.slice(0, MOST_ROWS);
  const there = new Set(all.map(WORDS.name));
  for (const [name, row] of view.rows) if (!there.has(name)) view.rows.delete(name) && row.node.remove();
  const nodes = shown.map((one) => {
    const name = WORDS.name(one);
    const row = view.rows.get(name) || benchRow(one);
    view.rows.set(name, row);
    row.update(one);
    return row.node;
  });
  place(view.benchBody, nodes);
  const cut = found.length > MOST_ROWS ? WORDS.benchesCut(MOST_ROWS) : "";
  text(view.benchSaid, all.length ? WORDS.benchesShown(shown.length, all.length) + cut : WORDS.noBench);
  view.benchTable.hidden = !shown.length;
  drawStates();
}

// Sets the children of `parent` to these nodes; nodes that are already in place stay untouched.
function place(parent, nodes) {
  const asking = view.asking && nodes.indexOf(view.asking.row.node);
  if (view.asking && asking >= 0) nodes.splice(asking + 1, 0, view.asking.node);
  const stay = new Set(nodes);
  for (const node of [...parent.children]) if (!stay.has(node)) node.remove();
  nodes.forEach((node, at) => {
    if (parent.children[at] !== node) parent.insertBefore(node, parent.children[at] || null);
  });
}

// Shows the number of benches in each state, as options of a filter.
function drawStates() {
  const count = (state) => view.fleet.benches.filter((one) => one.state === state).length;
  const loud = view.fleet.benches.filter((one) => LOUD.includes(one.state)).length;
  choose(view.state, [
    ["", WORDS.counted(view.fleet.benches.length, WORDS.all)],
    ["loud", WORDS.counted(loud, `▲ ${WORDS.loud}`)],
    ...Object.keys(WORDS.states).map((state) => [state, WORDS.counted(count(state), signed(stateOf(state)))]),
  ]);
}

// Sets the options without a change of the selection.
function choose(select, choices) {
  const key = JSON.stringify(choices);
  if (select.dataset.key === key) return;
  select.dataset.key = key;
  const chosen = select.value;
  const known = [...select.options];
  if (known.length === choices.length && known.every((one, at) => one.value === choices[at][0]))
    known.forEach((one, at) => text(one, choices[at][1]));
  else select.replaceChildren(...choices.map(([value, words]) => new Option(words, value)));
  select.value = chosen;
  if (select.selectedIndex < 0) select.selectedIndex = 0;
}

// Performs an action of a form and returns whether it succeeded. The form shows a refusal next to the button.
async function doing(said, work, words) {
  const { ctx } = view;
  text(said, "");
  try {
    const answer = await work();
    await ctx.attempt(
      () => answer,
      () => words(answer),
    );
    return true;
  } catch (error) {
    text(said, error instanceof ctx.Refused ? WORDS.notDone(error.message) : WORDS.notKnown(error.message));
    return false;
  }
}

// ---- hold, drain and release of a bench -----------------------------------------------------------

// Asks for a reason, in a row below that of the bench.
function askWhy(row, kind) {
  const name = WORDS.name(row.bench);
  const said = el("p", { class: "bad", role: "alert", id: id("said") });
  const why = el("input", { maxlength: 200, autocomplete: "off", "aria-describedby": said.id });
  const onsubmit = async (event) => {
    event.preventDefault();
    if (!why.value.trim()) {
      text(said, WORDS.whyMissing);
      return why.focus();
    }
    const words = (answer) => [WORDS.acted[kind](name), answer && answer.words].filter(Boolean).join(" ");
    const isDone = await doing(said, () => view.ctx.post(pathOf(row.bench, kind), { why: why.value.trim() }), words);
    return isDone ? closeWhy() : undefined;
  };
  const form = el(
    "form",
    { class: "fl-why-form", onsubmit },
    el("p", {}, el("b", {}, WORDS.asked[kind](name))),
    el("label", {}, WORDS.why, why),
    said,
    el("div", { class: "acts" }, el("button", {}, WORDS.go[kind]), button(WORDS.not, closeWhy)),
  );
  if (view.asking) view.asking.node.remove();
  const columns = Object.keys(WORDS.columns).length;
  view.asking = { row, node: el("tr", { class: "fl-ask" }, el("td", { colspan: columns }, form)) };
  row.node.after(view.asking.node);
  why.focus();
}

function closeWhy() {
  if (!view || !view.asking) return;
  const { row, node } = view.asking;
  view.asking = null;
  node.remove();
  const next = row.node.querySelector(".fl-acts button:not([hidden], :disabled)");
  if (next) next.focus();
  poll();
}

// ---- the stop -----------------------------------------------------------------------------------

// Returns the outcome for a bench according to the reply. A bench without a report was not reached, and an output that
// was not read back is not verified.
function fateOf(name, found) {
  const report = found && found.report;
  const words = [found && found.words, report && report.message, ...outputsOf(report)].filter(Boolean).join("; ");
  if (!found || !found.heard) return { name, kind: "unreached", words: words || WORDS.stopNoWord };
  const isOver = report && report.over !== false;
  const kind =
    isOver && report.verified === true ? "off" : isOver && report.simulated === true ? "simulated" : "unverified";
  return { name, kind, words };
}

const outputsOf = (report) => ((report && report.outputs) || []).map((output) => output.text);

const FATES = {
  unreached: WORDS.stopNotReached,
  unverified: WORDS.stopNotVerified,
  simulated: WORDS.stopSim,
  off: WORDS.stopOff,
};

// The outcomes of a stop, of all benches or of one, by the name of the bench.
function reportsOf(answer) {
  const list = answer.benches || [answer];
  return new Map(list.map((one) => [WORDS.name(one), one]));
}

function tellStop(answer, benches) {
  const reports = reportsOf(answer);
  // A bench that replied but was unknown here is listed, too.
  const names = [...new Set([...benches.map(WORDS.name), ...reports.keys()])];
  const fates = names.map((name) => fateOf(name, reports.get(name)));
  const of = (kind) => fates.filter((one) => one.kind === kind);
  const count = (kind, words) => (of(kind).length ? words(of(kind).length) : "");
  const { unreached } = answer;
  const isFine = fates.length > 0 && !unreached && !of("unreached").length && !of("unverified").length;
  // The worst first.
  const head =
    (unreached ? WORDS.stopMissed(unreached) : "") +
    count("unreached", WORDS.stopUnreached) +
    count("unverified", WORDS.stopUnverified) +
    WORDS.stopOf(of("off").length, fates.length) +
    count("simulated", WORDS.stopSimulated);
  if (view) drawStopped(fates, head, isFine);
  return [head, !isFine];
}

function drawStopped(fates, head, isFine) {
  const line = (one) =>
    el(
      "li",
      { class: ["off", "simulated"].includes(one.kind) ? "" : "bad" },
      el("b", {}, FATES[one.kind](one.name)),
      one.words ? ` ${one.words}` : "",
    );
  const fine = fates.filter((one) => ["off", "simulated"].includes(one.kind));
  const loud = fates.filter((one) => !fine.includes(one));
  const close = () => {
    view.stopped.hidden = true;
    view.heading.focus();
  };
  view.stopped.hidden = false;
  view.stopped.replaceChildren(
    el("h3", { id: "fl-stopped" }, WORDS.stopped),
    el("p", { class: isFine ? "good" : "bad" }, el("b", {}, head)),
    el("ul", {}, ...loud.map(line)),
    el(
      "details",
      { open: !loud.length && fine.length < 10 },
      el("summary", {}, WORDS.stopFine(fine.length)),
      el("ul", {}, ...fine.map(line)),
    ),
    el("div", { class: "acts" }, button(WORDS.close, close)),
  );
}

async function stop(ctx, path, body, benches, node, label) {
  const answer = await ctx.stop(node, path, { body, patience: STOP_MS, waits: WORDS.stopWaits });
  text(node, label);
  // A refusal has already been shown at the button.
  if (answer !== null) ctx.stopSays(...tellStop(answer, benches));
  poll();
}

const stopBench = (one, node) => stop(view.ctx, pathOf(one, "stop"), { why: WORDS.stopWhy }, [one], node, WORDS.stop);

// Stops every bench of the fleet, also for a user who may see nothing.
export const stopAll = (ctx) =>
  stop(ctx, "/fleet/stop", undefined, view && view.fleet ? view.fleet.benches : [], $("stopfleet"), WORDS.stopAll);

// ---- jobs ---------------------------------------------------------------------------------------

const jobState = (state) => WORDS.jobStates[state] || ["?", state];

function needsOf(needs) {
  const words = Object.entries(needs || {})
    .filter(([, value]) => !isUnset(value))
    .map(([name, value]) => (WORDS.need[name] ? WORDS.need[name](value) : `${name} ${value}`));
  return words.join("; ") || WORDS.anyBench;
}

function jobRow(job) {
  const heads = WORDS.jobColumns;
  const [sign, words] = jobState(job.state);
  const isOpen = job.state === "queued";
  const cancel = () =>
    view.ctx
      .attempt(
        () => view.ctx.remove(`/fleet/jobs/${encodeURIComponent(job.job)}`),
        () => WORDS.cancelled(job.name),
      )
      .then(() => askJobs());
  const act = button(WORDS.cancel, cancel, {
    "aria-label": WORDS.actOn(WORDS.cancel, job.job),
    disabled: Boolean(lack(view.ctx, "energise")),
  });
  return el(
    "tr",
    { "data-key": job.job },
    el("th", { scope: "row" }, el("div", { class: "fd-name" }, job.name), el("small", {}, job.job)),
    cell(heads.state, el("span", { class: `fl-job fl-${job.state}` }, WORDS.sign(sign, words))),
    cell(heads.words, el("div", { class: "fd-name" }, job.words || WORDS.unknown)),
    cell(heads.needs, needsOf(job.needs)),
    cell(heads.bench, el("div", { class: "fd-name" }, job.bench || WORDS.unknown)),
    cell(heads.run, el("div", { class: "fd-name" }, job.run || WORDS.unknown)),
    cell(heads.submitted, when(job.submitted_unix_s)),
    cell(heads.by, el("div", { class: "fd-name" }, person(job.by || WORDS.unknown))),
    cell(heads.campaign, el("div", { class: "fd-name" }, job.campaign || WORDS.unknown)),
    el("td", {}, isOpen ? act : null),
  );
}

function jobsQuery(after) {
  const query = new URLSearchParams({ most: JOBS });
  if (view.jobState.value) query.set("state", view.jobState.value);
  if (view.campaign.value.trim()) query.set("campaign", view.campaign.value.trim());
  if (after) query.set("after", after);
  return query;
}

// A page of jobs at a time: never more rows than that.
async function askJobs(page = view.page) {
  const mine = view;
  const turn = (mine.jobTurn += 1);
  mine.jobsAt = Date.now();
  const got = await mine.ctx.get(`/fleet/jobs?${jobsQuery(page.after)}`).catch(() => null);
  if (!got || view !== mine || turn !== mine.jobTurn) return false;
  mine.page = { ...page, next: got.after, shown: got.jobs.length };
  fill(mine.jobBody, ...got.jobs.map(jobRow));
  mine.jobTable.hidden = !got.jobs.length;
  const first = page.before + 1;
  text(mine.jobSaid, WORDS.jobsShown(first, got.jobs.length ? page.before + got.jobs.length : 0));
  mine.nextJobs.disabled = !got.after;
  mine.firstJobs.disabled = !page.before;
  return true;
}

const FIRST_PAGE = { after: null, before: 0 };
const firstJobs = () => askJobs(FIRST_PAGE);
const nextJobs = () => askJobs({ after: view.page.next, before: view.page.before + view.page.shown });

function drawJobStates(counts) {
  const all = Object.values(counts).reduce((sum, n) => sum + n, 0);
  choose(view.jobState, [
    ["", WORDS.counted(all, WORDS.all)],
    ...Object.keys(WORDS.jobStates).map((state) => [state, WORDS.counted(counts[state] || 0, signed(jobState(state)))]),
  ]);
}

// ---- runs that are lost -------------------------------------------------------------------------

async function askLost(number) {
  const mine = view;
  const asked = number
    ? mine.ctx.get(`/fleet/jobs?${new URLSearchParams({ state: "lost", most: LOST })}`)
    : { jobs: [] };
  const got = await Promise.resolve(asked).catch(() => null);
  if (!got || view !== mine) return;
  const there = new Set(got.jobs.map((job) => job.job));
  for (const [job, node] of mine.lostNodes) if (!there.has(job)) mine.lostNodes.delete(job) && node.remove();
  for (const job of got.jobs)
    if (!mine.lostNodes.has(job.job)) {
      mine.lostNodes.set(job.job, lostItem(job));
      mine.lostList.append(mine.lostNodes.get(job.job));
    }
  mine.lost.hidden = !got.jobs.length;
  text(mine.lostMore, number > got.jobs.length && got.jobs.length ? WORDS.lostMore(number - got.jobs.length) : "");
}

// A question to the user. It is drawn once, so that no typed text or tick is lost.
function lostItem(job) {
  const lacks = lack(view.ctx, "energise");
  const said = el("p", { class: "bad", role: "alert", id: id("lost") }, lacks || "");
  const looked = el("input", { type: "checkbox", disabled: Boolean(lacks) });
  const why = el("input", {
    maxlength: 200,
    autocomplete: "off",
    disabled: Boolean(lacks),
    "aria-describedby": said.id,
  });
  const onsubmit = async (event) => {
    event.preventDefault();
    text(said, !looked.checked ? WORDS.lostTick : why.value.trim() ? "" : WORDS.whyMissing);
    if (said.textContent) return (looked.checked ? why : looked).focus();
    const path = `/fleet/jobs/${encodeURIComponent(job.job)}/release`;
    const release = () => view.ctx.post(path, { why: why.value.trim() });
    const isDone = await doing(said, release, () => WORDS.lostDone(job.name));
    if (!isDone || !view) return undefined;
    view.heading.focus();
    return poll();
  };
  const form = el(
    "form",
    { class: "fl-judge", onsubmit },
    job.words ? el("p", {}, job.words) : null,
    el("label", { class: "fl-tick" }, looked, el("span", {}, WORDS.lostLooked)),
    el("label", {}, WORDS.why, why),
    said,
    el("div", { class: "acts" }, el("button", { disabled: Boolean(lacks) }, WORDS.lostGo)),
  );
  return el("li", {}, el("details", {}, el("summary", {}, WORDS.lostOf(job)), form));
}

// ---- sending an experiment ----------------------------------------------------------------------

const known = (value) => Number.isFinite(value);
const round = (value) => String(Number(value.toPrecision(4))).replace("-", "−");

function sendForm() {
  const parts = {};
  view.send = parts;
  Object.assign(parts, { checked: null, count: el("input", { type: "number", min: 1, max: MOST_COUNT, value: 1 }) });
  parts.experiment = el("select", { onchange: takeExperiment }, new Option(WORDS.ownText, ""));
  parts.file = el("input", { type: "file", accept: ".toml,text/plain", onchange: takeFile });
  parts.text = el("textarea", {
    rows: 8,
    spellcheck: "false",
    autocomplete: "off",
    wrap: "off",
    class: "fl-text",
    oninput: changed,
  });
  parts.bench = el("select", { onchange: changed }, ...view.ctx.benches().map((name) => new Option(name, name)));
  parts.said = el("div", { role: "status" });
  parts.needs = Object.fromEntries(NEEDS.map((name) => [name, needInput(name)]));
  parts.seed = el("input", {
    inputmode: "numeric",
    autocomplete: "off",
    placeholder: WORDS.seedHint,
    oninput: drawReason,
  });
  parts.label = el("input", { autocomplete: "off", maxlength: 100 });
  parts.count.addEventListener("input", drawReason);
  parts.reason = el("p", { class: "quiet", id: id("reason") });
  parts.go = el("button", { "aria-describedby": parts.reason.id }, WORDS.send);
  parts.confirm = el("div", {
    class: "fl-confirm",
    role: "group",
    tabindex: "-1",
    "aria-label": WORDS.submit,
    hidden: true,
  });
  const label = (words, node, more) => el("label", more || {}, words, node);
  const fields = NEEDS.map((name) => label(WORDS.fields[name], parts.needs[name]));
  const onsubmit = (event) => {
    event.preventDefault();
    confirm();
  };
  return el(
    "form",
    { class: "fl-send", onsubmit },
    el("div", { class: "fl-grid" }, label(WORDS.experiment, parts.experiment), label(WORDS.file, parts.file)),
    label(WORDS.text, parts.text),
    el("div", { class: "acts" }, label(WORDS.checkOn, parts.bench), button(WORDS.check, check)),
    el("p", { class: "quiet" }, WORDS.checkHint),
    parts.said,
    el("fieldset", {}, el("legend", {}, WORDS.needs), el("div", { class: "fl-grid" }, ...fields)),
    el(
      "div",
      { class: "fl-grid" },
      label(WORDS.count, parts.count),
      label(WORDS.seed, parts.seed),
      label(WORDS.label, parts.label),
    ),
    el("div", { class: "acts" }, parts.go),
    parts.reason,
    parts.confirm,
  );
}

// Fixtures, sites and benches are those of the fleet.
function needInput(name) {
  const isNumber = ["current_a", "temperature_c"].includes(name);
  return isNumber
    ? el("input", { inputmode: "decimal", autocomplete: "off", oninput: drawReason })
    : el("select", { onchange: drawReason }, new Option(WORDS.any, ""));
}

function drawNeeds() {
  const { benches } = view.fleet;
  const unique = (values) => [...new Set(values)].sort((a, b) => a.localeCompare(b));
  const offer = (name, values) =>
    choose(view.send.needs[name], [["", WORDS.any], ...unique(values).map((value) => [value, value])]);
  offer(
    "fixture",
    benches.flatMap((one) => (one.capabilities && one.capabilities.fixtures) || []),
  );
  offer(
    "site",
    benches.map((one) => one.site),
  );
  offer(
    "bench",
    benches.map((one) => one.bench),
  );
}

async function takeExperiment() {
  const mine = view;
  const name = mine.send.experiment.value;
  const asked = () => mine.ctx.get(`/files/experiments/${encodeURIComponent(name)}`);
  // Text that the user writes is kept.
  const got = name ? await mine.ctx.attempt(asked) : null;
  if (!got || view !== mine || mine.send.experiment.value !== name) return;
  mine.send.text.value = got.text;
  changed();
}

async function takeFile(event) {
  const mine = view;
  const [file] = event.target.files;
  const words = file && (await file.text());
  if (!file || view !== mine) return;
  mine.send.text.value = words;
  mine.send.experiment.value = "";
  changed();
}

// Only the checked text is submitted: each change invalidates the check.
function changed() {
  view.send.confirm.hidden = true;
  drawReason();
}

async function check() {
  const mine = view;
  const { send } = mine;
  const draft = { text: send.text.value, bench: send.bench.value };
  send.checked = null;
  send.confirm.hidden = true;
  fill(send.said, el("p", {}, WORDS.checking));
  try {
    const answer = await mine.ctx.post("/drafts", draft);
    if (view !== mine) return;
    const isFine = !answer.mistakes.length && answer.plan;
    if (isFine) send.checked = { ...draft, plan: answer.plan, value: answer.value };
    fill(send.said, ...(isFine ? planOf(answer) : answer.mistakes.map(mistakeOf)));
    if (isFine) takeCurrent(answer.margins);
  } catch (error) {
    if (view !== mine) return;
    fill(send.said, el("p", { class: "bad" }, WORDS.notChecked(error.message)));
  }
  drawReason();
}

const mistakeOf = (one) => el("p", { class: "bad" }, WORDS.mistake(one));

function planOf({ plan, margins }) {
  const item = (one) => {
    const isBeyond = one.margin < 0;
    const planned = { least: round(one.planned_least), greatest: round(one.planned_greatest) };
    const words = WORDS.margin({ ...one, ...planned, isBeyond, margin: round(Math.abs(one.margin)) });
    return el("li", { class: isBeyond ? "bad" : "" }, words);
  };
  return [
    el("p", { class: "good" }, WORDS.plan(duration(plan.expected_s), duration(plan.longest_s))),
    el("ul", {}, ...margins.filter((one) => known(one.margin)).map(item)),
  ];
}

// The greatest current of the plan is the required capability, unless the user has set another one.
function takeCurrent(margins) {
  const amps = margins.filter((one) => one.unit === "A").flatMap((one) => [one.planned_least, one.planned_greatest]);
  const greatest = Math.max(0, ...amps.filter(known).map(Math.abs));
  const field = view.send.needs.current_a;
  if (greatest && !field.value.trim()) field.value = String(Math.ceil(100 * greatest) / 100);
}

function neededNow() {
  const needs = {};
  for (const name of NEEDS) {
    const value = view.send.needs[name].value.trim();
    if (value) needs[name] = ["current_a", "temperature_c"].includes(name) ? Number(value.replace(",", ".")) : value;
  }
  return needs;
}

function reasonNow() {
  const { send } = view;
  const needs = neededNow();
  const lacks = lack(view.ctx, "energise");
  if (lacks) return lacks;
  if (!send.checked) return WORDS.reasons.check;
  if (send.checked.text !== send.text.value || send.checked.bench !== send.bench.value) return WORDS.reasons.changed;
  const isWrong = (name) => name in needs && !known(needs[name]);
  if (isWrong("current_a") || needs.current_a <= 0 || isWrong("temperature_c")) return WORDS.reasons.number;
  const count = Number(send.count.value);
  if (!Number.isInteger(count) || count < 1 || count > MOST_COUNT) return WORDS.reasons.count;
  const seed = send.seed.value.trim();
  const isSeed = !seed || (/^[0-9]+$/.test(seed) && Number.isSafeInteger(Number(seed)));
  return isSeed ? "" : WORDS.reasons.seed;
}

function drawReason() {
  const reason = reasonNow();
  view.send.go.disabled = Boolean(reason);
  view.send.confirm.hidden ||= Boolean(reason);
  text(view.send.reason, reason);
}

// Returns whether a bench has the required capabilities.
function fits(one, needs) {
  const can = one.capabilities || {};
  const [low, high] = can.temperature_c || [null, null];
  return (
    (!("current_a" in needs) || (known(can.current_a) && needs.current_a <= can.current_a)) &&
    (!("temperature_c" in needs) || (known(low) && low <= needs.temperature_c && needs.temperature_c <= high)) &&
    (!needs.fixture || (can.fixtures || []).includes(needs.fixture)) &&
    (!needs.site || one.site === needs.site) &&
    (!needs.bench || one.bench === needs.bench)
  );
}

// Shows what is submitted, how often and which benches can run it, and asks for a confirmation.
function confirm() {
  if (reasonNow()) return drawReason();
  const { send, fleet } = view;
  const needs = neededNow();
  const count = Number(send.count.value);
  const { plan, value } = send.checked;
  const body = { text: send.checked.text, needs, count };
  if (send.label.value.trim()) body.campaign = send.label.value.trim();
  if (send.seed.value.trim()) body.seed = Number(send.seed.value);
  const able = fleet.benches.filter((one) => fits(one, needs)).length;
  const not = () => {
    send.confirm.hidden = true;
    send.go.focus();
  };
  send.confirm.replaceChildren(
    el("p", {}, el("strong", {}, WORDS.confirm((value && value.name) || plan.experiment, count))),
    el("p", {}, WORDS.confirmTime(duration(plan.expected_s), count)),
    el("p", {}, needsOf(needs)),
    el("p", { class: able ? "" : "bad" }, able ? WORDS.fits(able, fleet.benches.length) : WORDS.fitsNone),
    el(
      "div",
      { class: "acts" },
      button(WORDS.yes, () => sendNow(body)),
      button(WORDS.not, not),
    ),
  );
  send.confirm.hidden = false;
  return send.confirm.focus();
}

async function sendNow(body) {
  const mine = view;
  const { send } = mine;
  send.confirm.hidden = true;
  // It cannot be sent twice by pressing twice: it is checked anew for that.
  send.checked = null;
  drawReason();
  fill(send.said, el("p", {}, WORDS.sending));
  let line;
  try {
    const { jobs } = await mine.ctx.post("/fleet/jobs", body);
    line = el("p", { class: "good", tabindex: "-1" }, WORDS.sent(jobs));
  } catch (error) {
    const words = error instanceof mine.ctx.Refused ? WORDS.refused : WORDS.noAnswer;
    line = el("p", { class: "bad", tabindex: "-1" }, words(error.message));
  }
  if (view !== mine) return;
  send.said.replaceChildren(line);
  line.focus();
  askJobs();
}

async function offerExperiments() {
  const mine = view;
  const offered = await mine.ctx.get("/experiments").catch(() => []);
  if (view !== mine) return;
  mine.send.experiment.append(...offered.map((one) => new Option(one.experiment, one.experiment)));
}

// ---- the view -----------------------------------------------------------------------------------

function take(fleet) {
  const benches = [...fleet.benches].sort((a, b) =>
    WORDS.name(a).localeCompare(WORDS.name(b), undefined, { numeric: true }),
  );
  const counts = JSON.stringify(fleet.jobs);
  const isNew = counts !== view.counts;
  view.counts = counts;
  view.fleet = { ...fleet, benches };
  view.heardAt = Date.now();
  text(view.heading, WORDS.named(fleet.fleet));
  text(view.said, fleet.connected ? WORDS.connected(fleet.server) : WORDS.apart(fleet.server));
  view.said.className = fleet.connected ? "quiet" : "bad";
  drawBenches();
  drawNeeds();
  drawJobStates(fleet.jobs);
  if (!isNew && Date.now() - view.jobsAt < JOBS_MS) return;
  askLost(fleet.jobs.lost || 0);
  askJobs();
}

// Sends one request; a late reply is dropped.
async function poll() {
  const mine = view;
  if (!mine || !mine.fleet) return;
  const turn = (mine.turn += 1);
  try {
    const fleet = await mine.ctx.get("/fleet");
    if (view === mine && turn === mine.turn) take(fleet);
  } catch (error) {
    if (view !== mine || turn !== mine.turn) return;
    mine.said.className = "bad";
    text(mine.said, WORDS.old(duration((Date.now() - mine.heardAt) / 1000), error.message));
  }
}

// Each request follows the reply to the previous one: a slow server never gets two at once.
async function keepAsking(mine) {
  while (view === mine) {
    await new Promise((done) => setTimeout(done, POLL_MS));
    if (view === mine && !document.hidden) await poll();
  }
}

const section = (name, words, ...parts) =>
  el("section", { "aria-labelledby": `fl-${name}` }, el("h3", { id: `fl-${name}` }, words), ...parts);

function benchSection() {
  view.find = el("input", { type: "search", autocomplete: "off", oninput: drawBenches });
  view.state = el("select", { onchange: drawBenches });
  view.benchSaid = el("p", { class: "quiet", role: "status" });
  view.benchBody = el("tbody", {});
  view.benchTable = table(WORDS.benches, Object.values(WORDS.columns), view.benchBody);
  view.benchTable.classList.add("fl-tall");
  const lacks = lack(view.ctx, "energise");
  const filter = el(
    "div",
    { class: "fl-grid" },
    el("label", {}, WORDS.find, view.find),
    el("label", {}, WORDS.state, view.state),
  );
  return section(
    "benches",
    WORDS.benches,
    filter,
    view.benchSaid,
    lacks ? el("p", { class: "quiet" }, lacks) : null,
    view.benchTable,
  );
}

function jobSection() {
  view.jobState = el("select", { onchange: firstJobs });
  view.campaign = el("input", { type: "search", autocomplete: "off", onchange: firstJobs });
  view.jobSaid = el("p", { class: "quiet", role: "status" });
  view.jobBody = el("tbody", {});
  view.jobTable = table(WORDS.jobs, Object.values(WORDS.jobColumns), view.jobBody);
  view.jobTable.classList.add("fl-tall");
  view.firstJobs = button(WORDS.first, firstJobs, { disabled: true });
  view.nextJobs = button(WORDS.next, nextJobs, { disabled: true });
  const filter = el(
    "div",
    { class: "fl-grid" },
    el("label", {}, WORDS.state, view.jobState),
    el("label", {}, WORDS.campaign, view.campaign),
  );
  return section(
    "jobs",
    WORDS.jobs,
    filter,
    view.jobSaid,
    view.jobTable,
    el("div", { class: "acts" }, view.firstJobs, view.nextJobs),
  );
}

function build(parent) {
  view.said = el("p", { role: "status" }, WORDS.looking);
  view.stopped = el("section", { "aria-labelledby": "fl-stopped", hidden: true });
  view.lostList = el("ul", { class: "fl-list" });
  view.lostMore = el("p", {});
  view.lost = section(
    "lost",
    WORDS.lost,
    el("p", {}, WORDS.lostHint, el("b", {}, WORDS.lostWarn)),
    view.lostList,
    view.lostMore,
  );
  view.lost.classList.add("asks");
  view.lost.hidden = true;
  const send = el("section", {}, el("details", {}, el("summary", {}, WORDS.submit), sendForm()));
  const root = begin(parent, WORDS.title, view.said, view.stopped, view.lost, benchSection(), jobSection(), send);
  view.heading = root.querySelector("h2");
  drawReason();
}

async function first() {
  const mine = view;
  const fleet = await mine.ctx.get("/fleet");
  if (view === mine) take(fleet);
}

export async function open(parent, ctx) {
  view = { ctx, fleet: null, rows: new Map(), lostNodes: new Map(), turn: 0, jobTurn: 0, jobsAt: 0, page: FIRST_PAGE };
  const mine = view;
  build(parent);
  await ctx.attempt(first);
  if (view !== mine) return;
  $("stopfleet").hidden = false;
  $("stopfleet").onclick = () => stopAll(ctx);
  // If the server did not reply at first, the request is sent again.
  mine.fleet ||= { benches: [], jobs: {} };
  mine.heardAt ||= Date.now();
  offerExperiments();
  keepAsking(mine);
}

export function close() {
  view = null;
  $("stopfleet").hidden = true;
}
