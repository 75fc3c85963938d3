// Analyses of runs: start them, follow their progress, and read their results.
"use strict";

import { duration, el, fill, person, text, when } from "./bench.js";
import {
  drawFiles,
  drawPictures,
  drawResults,
  drawStory,
  investigationForm,
  investigationState,
  investigationUse,
  investigationView,
} from "./story.js";

const WORDS = {
  title: "Analyses",
  begin: "Begin an analysis",
  all: "All analyses",
  kind: "Kind",
  kinds: {
    fit: ["Fit", "A model of the impedance: resistances and RC branches, or a circuit, with uncertainties."],
    kk: ["Kramers–Kronig", "Tests whether spectra are valid: drift, non-linearity and noise; with DRT on request."],
    diagnose: ["Diagnosis", "Where simulation and measurement disagree, what is missing, how sure that is, what next."],
  },
  options: "Options",
  noOptions: "This kind has no options. It queues experiments by itself: current will flow.",
  rc: "RC branches",
  rcHelp: "Numbers from 1 to 8, parted by commas, such as 1,2,3; “all” for all orders; “auto” to choose one.",
  rcWrong: "RC branches: write numbers from 1 to 8 parted by commas, “all” or “auto”.",
  circuit: "Circuit (may be empty)",
  circuitHelp: "As impedance.py writes it: R0-p(R1,C1)-p(R2-Wo1,CPE1). It replaces the RC branches.",
  objective: "Objective",
  objectives: [
    ["", "default of the program"],
    ["complex", "complex: least squares, weighted by the stated covariance"],
    ["modulus", "modulus: magnitudes only, the phase is ignored"],
    ["sum-abs", "sum-abs: sum of |Z model − Z data|, robust against outliers"],
  ],
  objectiveHelp: "Function that the fit minimises.",
  drt: "Distribution of relaxation times (DRT)",
  drtHelp: "Adds the DRT with the band of its noise, and start values for a fit.",
  order: "Order of the model (may be empty)",
  orderHelp: "Number of RC branches of the model that is judged, 1 to 8. Empty: the recommended one.",
  orderWrong: "Order: write a whole number from 1 to 8, or nothing.",
  runs: "Runs",
  search: "Search the runs",
  searchHelp: "By name, cell, bench, experiment or note. Tick one or several.",
  searching: "Searching …",
  found: (n, more) => `${n} ${n === 1 ? "run" : "runs"} found${more ? ", there are more" : ""}.`,
  more: "Show more runs",
  none: "No run is chosen yet.",
  chosen: (n) => `${n} ${n === 1 ? "run" : "runs"} chosen:`,
  drop: "Remove",
  run: (run) =>
    `${run.experiment} on ${run.bench}, ${when(run.started_unix_s)}; ` +
    `${run.cells.map((one) => one.name).join(", ") || "no cell"}; ` +
    `${run.spectra} ${run.spectra === 1 ? "spectrum" : "spectra"}`,
  verdicts: {
    good: "✓ good",
    doubtful: "▲ doubtful",
    stopped: "■ stopped",
    failed: "✕ failed",
    unfinished: "… unfinished",
    damaged: "✕ damaged",
  },
  spectra: "Only some of the spectra",
  spectraHelp: "None ticked: all spectra of the chosen runs.",
  spectraNone: "The chosen runs have no spectra.",
  spectraFirst: "Choose a run first.",
  noRuns: "Choose at least one run.",
  submit: "Begin",
  sending: "Being submitted …",
  needs: (scope, has) => `needs the scope ${scope}; your token has ${has}`,
  nothing: "no scope",
  head: ["Analysis", "Runs", "State", "Time left", "Begun", "By", "Cancel"],
  empty: "No analysis yet.",
  older: "Show older analyses",
  loading: "Loading …",
  failedLoad: (message) => `✕ Not loaded: ${message}`,
  again: "Try again",
  states: {
    waiting: "○ waiting",
    "in work": "▶ in work",
    done: "✓ done",
    failed: "✕ failed",
    cancelled: "■ cancelled",
  },
  progressOf: (name) => `Progress of ${name}`,
  share: (done) => (done === null ? "not known" : `${Math.round(100 * done)} %`),
  left: (s) => (s === null ? "not known" : `about ${duration(s)}`),
  dash: "–",
  cancel: "Cancel",
  cancelOf: (name) => `Cancel ${name}`,
  cancelSure: "Cancel it? What it has computed is lost.",
  cancelYes: "Yes, cancel it",
  cancelNo: "No, let it go on",
  cancelling: "It is being cancelled …",
  cancelled: (name) => `${name} is cancelled.`,
  one: (a) => `${(WORDS.kinds[a.kind] || [a.kind])[0]} of ${a.runs.join(", ")}`,
  back: "All analyses",
  facts: {
    runs: "Runs",
    options: "Options",
    by: "By",
    begun: "Begun",
    ended: "Ended",
    left: "Time left, by the clock",
    id: "Name",
  },
  command: "The same on the command line",
  copy: "Copy",
  copied: "✓ The command line is copied.",
  notCopied: "It could not be copied: it is selected, press Ctrl+C.",
  log: "Log",
  logEmpty: "The log is empty.",
  measured: "The measured spectra",
  measuredNone: "These runs have no spectra.",
  failed: "✕ The analysis failed",
  noMessage: "The server gives no reason; see the log.",
  wasCancelled: "■ The analysis was cancelled.",
  unknown: (noun, id) => `The ${noun} ${id} could not be loaded.`,
  nouns: { analysis: "analysis", investigation: "investigation" },
  investigations: "Investigations",
  investigation: "Investigation until it is clear",
  investigationOf: (one) => `Investigation of ${one.run}`,
  investigationBy: (one) => ` by ${person(one.by)}, ${when(one.submitted_unix_s)}; ${investigationUse(one).join(", ")}`,
  endSure: "Cancel it? An experiment that waits is taken out of the queue; one that runs goes on to its end.",
};

const KINDS = Object.keys(WORDS.kinds);
// Kinds that may be of some of the spectra only.
const OF_SPECTRA = ["fit", "kk"];
const SCOPES = ["read", "operate", "energise", "clear-trip"];
const FOUND = 30;
const SHOWN = 50;
const SEARCH_MS = 300;
const LOG_MS = 2000;
const OVER = ["done", "failed", "cancelled"];

// The open view: late replies for another view are dropped.
let view = null;
let ids = 0;

const nameOf = (analysis) => WORDS.one(analysis);
const isOver = (analysis) => OVER.includes(analysis.state);
const at = (id) => `/analyses/${encodeURIComponent(id)}`;
const atInvestigation = (id) => `/investigations/${encodeURIComponent(id)}`;
const isInvestigation = (id) => /^investigation-\d+$/.test(id);
const newId = () => `an-${(ids += 1)}`;

// Target of the cancel button.
const OF_ANALYSIS = {
  name: nameOf,
  sure: WORDS.cancelSure,
  end: (ctx, id) => ctx.remove(at(id)),
  isOver,
};
const OF_INVESTIGATION = {
  name: WORDS.investigationOf,
  sure: WORDS.endSure,
  end: (ctx, id) => ctx.post(`${atInvestigation(id)}/cancel`, {}),
  isOver: (one) => Boolean(one.ended),
};

export async function open(parent, address, ctx) {
  const root = el("div", { class: "an-view" });
  parent.append(root);
  view = { root, ctx };
  const id = address.path[0] === "analysis" ? address.path[1] || "" : null;
  if (id !== null && isInvestigation(id)) await openInvestigation(view, id);
  else if (id !== null) await openOne(view, id);
  else await openAll(view, address.query);
}

export function heard(kind, data) {
  if (!view) return;
  if (kind === "analysis") view.putAnalysis(data);
  if (kind === "investigation" && view.putInvestigation) view.putInvestigation(data);
  if (kind === "hello" || kind === "lost") view.reload();
}

export function close() {
  if (view && view.over) view.over();
  view = null;
}

// Returns why an action is not possible with this token, or "" if it is.
function refusal(ctx, scope) {
  if (ctx.may(scope)) return "";
  return WORDS.needs(scope, SCOPES.filter(ctx.may).join(", ") || WORDS.nothing);
}

function title(words) {
  return el("h2", { tabindex: -1 }, words);
}

// ---- all of them --------------------------------------------------------------------------------

async function openAll(mine, query) {
  const heading = title(WORDS.title);
  const list = analysesTable(mine);
  const form = beginForm(mine, query, (analysis) => list.put(analysis));
  const investigations = investigationList(mine);
  mine.putAnalysis = list.put;
  mine.putInvestigation = investigations.put;
  mine.reload = () => Promise.all([list.load(), investigations.load()]);
  mine.over = form.over;
  const run = query.get("investigate");
  const asked = run
    ? el("section", {}, el("h3", {}, WORDS.investigation), investigationForm(mine.ctx, run, true))
    : "";
  mine.root.append(
    heading,
    asked,
    el("section", {}, el("h3", {}, WORDS.begin), form.node),
    investigations.node,
    el("section", {}, el("h3", {}, WORDS.all), list.node),
  );
  heading.focus();
  await Promise.all([form.begin(), mine.reload()]);
}

// Lists investigations, the latest first; empty if there are none.
function investigationList(mine) {
  const list = el("ul", { "aria-label": WORDS.investigations });
  const node = el("section", { hidden: true }, el("h3", {}, WORDS.investigations), list);
  const known = new Map();
  const draw = () => {
    const all = [...known.values()].sort((one, other) => other.submitted_unix_s - one.submitted_unix_s);
    node.hidden = !all.length;
    fill(list, ...all.slice(0, SHOWN).map(investigationItem));
  };
  const put = (one) => {
    known.set(one.id, one);
    draw();
  };
  const load = async () => {
    const all = await mine.ctx.attempt(() => mine.ctx.get("/investigations"));
    if (!all || view !== mine) return;
    all.forEach((one) => known.set(one.id, one));
    draw();
  };
  return { node, put, load };
}

function investigationItem(one) {
  const href = `#/analysis/${encodeURIComponent(one.id)}`;
  const [words] = investigationState(one);
  return el(
    "li",
    {},
    el("a", { href }, WORDS.investigationOf(one)),
    WORDS.investigationBy(one),
    el("small", {}, ` ${words}`),
  );
}

// Rows are updated in place, so that focus and scroll position survive incoming events.
function analysesTable(mine) {
  const rows = new Map();
  const body = el("tbody", {});
  const said = el("p", { class: "quiet", role: "status" }, WORDS.loading);
  const again = el("button", { type: "button", hidden: true, onclick: () => load() }, WORDS.again);
  const older = el("button", { type: "button", hidden: true, onclick: () => more() }, WORDS.older);
  const heads = WORDS.head.map((name) => el("th", { scope: "col" }, name));
  const table = el("table", {}, el("thead", {}, el("tr", {}, ...heads)), body);
  const frame = { class: "scroll stack an-list-of", tabindex: 0, role: "group", "aria-label": WORDS.all };
  const node = el("div", {}, said, again, el("div", frame, table), el("div", { class: "acts" }, older));
  let most = SHOWN;

  const arrange = () => {
    const order = [...rows.values()].sort((one, other) => other.begun - one.begun);
    order.forEach((row, place) => {
      row.node.hidden = place >= most;
      // Moving a row would take the focus from it.
      if (body.children[place] !== row.node) body.insertBefore(row.node, body.children[place] || null);
    });
    older.hidden = order.length <= most;
  };
  const more = () => {
    const first = [...body.children][most];
    most += SHOWN;
    arrange();
    if (first) first.querySelector("a").focus();
  };
  const put = (analysis) => {
    if (rows.has(analysis.id)) return rows.get(analysis.id).update(analysis);
    rows.set(analysis.id, analysisRow(mine.ctx, analysis, put));
    arrange();
    text(said, "");
    return undefined;
  };
  // An event that came while the list was on its way is newer than the list.
  const load = async () => {
    const newer = new Set();
    mine.putAnalysis = (analysis) => {
      newer.add(analysis.id);
      put(analysis);
    };
    again.hidden = true;
    try {
      const all = await mine.ctx.get("/analyses");
      all.filter((one) => !newer.has(one.id)).forEach(put);
      text(said, rows.size ? "" : WORDS.empty);
    } catch (error) {
      text(said, WORDS.failedLoad(error.message));
      again.hidden = false;
    }
  };
  return { node, put, load };
}

function analysisRow(ctx, first, put) {
  const link = el("a", { href: `#/analysis/${encodeURIComponent(first.id)}` });
  const runs = el("td", { "data-name": WORDS.head[1] }, ...linked(first.runs));
  const progress = progressBar(nameOf(first));
  const left = el("td", { "data-name": WORDS.head[3] });
  const by = el("td", { "data-name": WORDS.head[5] }, person(first.by));
  const cancel = canceller(ctx, first, link, put);
  const node = el(
    "tr",
    {},
    el("th", { scope: "row" }, link, el("small", {}, first.id)),
    runs,
    el("td", {}, progress.node),
    left,
    el("td", { "data-name": WORDS.head[4] }, when(first.submitted_unix_s)),
    by,
    el("td", {}, cancel.node),
  );
  const update = (analysis) => {
    text(link, (WORDS.kinds[analysis.kind] || [analysis.kind])[0]);
    link.setAttribute("aria-label", nameOf(analysis));
    progress.update(analysis);
    text(left, isOver(analysis) ? WORDS.dash : WORDS.left(analysis.left_s));
    cancel.update(analysis);
  };
  update(first);
  return { node, update, begun: first.submitted_unix_s };
}

// Names of runs as links, parted by commas.
function linked(runs) {
  return runs.flatMap((run, place) => [
    place ? ", " : "",
    el("a", { href: `#/run/${encodeURIComponent(run)}` }, run),
  ]);
}

// State as text, progress bar and present action.
function progressBar(name) {
  const state = el("span", { class: "an-state" });
  const bar = el("progress", { max: 1, "aria-label": WORDS.progressOf(name) });
  const share = el("b", {});
  const words = el("small", {});
  const line = el("div", { class: "an-progress" }, bar, share, words);
  const node = el("div", {}, state, line);
  const update = (analysis) => {
    const { done } = analysis.progress;
    text(state, WORDS.states[analysis.state] || analysis.state);
    state.className = `an-state ${analysis.state === "failed" ? "bad" : analysis.state === "done" ? "good" : ""}`;
    bar.hidden = share.hidden = isOver(analysis) || (analysis.state === "waiting" && done === null);
    if (done === null) bar.removeAttribute("value");
    else bar.value = done;
    text(share, WORDS.share(done));
    text(words, analysis.state === "failed" ? analysis.message || "" : isOver(analysis) ? "" : analysis.progress.words);
    line.hidden = isOver(analysis) && !words.textContent;
  };
  return { node, update };
}

// The cancel button; it asks for a confirmation in place. `next` gets the focus when there is nothing to cancel.
function canceller(ctx, first, next, put, about = OF_ANALYSIS) {
  const id = newId();
  const why = refusal(ctx, "operate");
  const name = about.name(first);
  const button = el("button", { type: "button", "aria-label": WORDS.cancelOf(name) }, WORDS.cancel);
  button.disabled = Boolean(why);
  const reason = el("small", { id, hidden: !why }, why);
  if (why) button.setAttribute("aria-describedby", id);
  const yes = el("button", { type: "button" }, WORDS.cancelYes);
  const no = el("button", { type: "button" }, WORDS.cancelNo);
  const said = el("span", {}, about.sure);
  const group = { class: "an-ask", role: "group", "aria-label": WORDS.cancelOf(name), hidden: true };
  const ask = el("div", group, said, yes, no);
  const node = el("div", {}, button, reason, ask);
  const asking = (on) => {
    [ask.hidden, button.hidden] = [!on, on];
    yes.disabled = no.disabled = false;
    text(said, about.sure);
  };
  button.addEventListener("click", () => {
    asking(true);
    no.focus();
  });
  no.addEventListener("click", () => {
    asking(false);
    button.focus();
  });
  yes.addEventListener("click", async () => {
    yes.disabled = no.disabled = true;
    text(said, WORDS.cancelling);
    const answer = await ctx.attempt(
      () => about.end(ctx, first.id),
      () => WORDS.cancelled(name),
    );
    if (answer && answer.id === first.id && answer.state) put(answer);
    if (node.hidden || answer) return;
    asking(false);
    button.focus();
  });
  const update = (analysis) => {
    if (node.hidden || !about.isOver(analysis)) return;
    const held = node.contains(document.activeElement) || !ask.hidden;
    node.hidden = true;
    if (held) next.focus();
  };
  return { node, update };
}

// ---- the form -----------------------------------------------------------------------------------

function beginForm(mine, query, put) {
  const { ctx } = mine;
  const chosen = new Set((query.get("runs") || "").split(",").filter(Boolean));
  const kind = KINDS.includes(query.get("kind")) ? query.get("kind") : "fit";
  const runs = runChooser(mine, chosen);
  const options = optionFields(query);
  const spectra = spectraChooser(mine, chosen);
  runs.changed = spectra.reload;
  const wrong = el("p", { class: "bad", role: "alert", hidden: true });
  const why = el("p", { class: "quiet", id: newId(), hidden: true });
  const submit = el("button", { type: "submit", "aria-describedby": why.id }, WORDS.submit);
  const form = el("form", { class: "an-form", novalidate: true });
  const pick = (now) => {
    options.show(now);
    spectra.node.hidden = !OF_SPECTRA.includes(now);
    const reason = refusal(ctx, "operate");
    submit.disabled = Boolean(reason);
    why.hidden = !reason;
    text(why, reason);
  };
  const kinds = kindFields(kind, pick);
  pick(kind);
  form.append(kinds.node, runs.node, options.node, spectra.node, wrong, el("div", { class: "acts" }, submit), why);
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    hand({ ctx, chosen, kinds, runs, options, spectra, wrong, submit, put });
  });
  return { node: form, begin: runs.search, over: runs.over };
}

// Submits the analysis, or shows what is wrong with which field.
async function hand({ ctx, chosen, kinds, runs, options, spectra, wrong, submit, put }) {
  const kind = kinds.chosen();
  const mistake = chosen.size ? options.mistake(kind) : { words: WORDS.noRuns, field: runs.field };
  runs.field.setAttribute("aria-invalid", String(!chosen.size));
  wrong.hidden = !mistake;
  text(wrong, mistake ? `✕ ${mistake.words}` : "");
  if (mistake) return mistake.field.focus();
  const body = { kind, runs: [...chosen], options: options.values(kind) };
  const some = OF_SPECTRA.includes(kind) ? spectra.chosen() : [];
  if (some.length) body.spectra = some;
  submit.disabled = true;
  text(submit, WORDS.sending);
  const analysis = await ctx.attempt(() => ctx.post("/analyses", body));
  submit.disabled = false;
  text(submit, WORDS.submit);
  if (!analysis) return submit.focus();
  put(analysis);
  return ctx.go(`#/analysis/${encodeURIComponent(analysis.id)}`);
}

function kindFields(kind, changed) {
  const boxes = KINDS.map((name) => {
    const id = newId();
    const box = { type: "radio", name: "an-kind", value: name, id, checked: name === kind };
    const input = el("input", { ...box, "aria-describedby": `${id}-help`, onchange: () => changed(name) });
    const [words, help] = WORDS.kinds[name];
    return el(
      "div",
      { class: "an-kind" },
      input,
      el("label", { for: id }, words),
      el("small", { id: `${id}-help` }, help),
    );
  });
  const node = el(
    "fieldset",
    {},
    el("legend", {}, WORDS.kind),
    el("div", { class: "an-kinds" }, ...boxes),
  );
  return { node, chosen: () => node.querySelector("input:checked").value };
}

function field(label, help, control) {
  const id = newId();
  control.id = id;
  control.setAttribute("aria-describedby", `${id}-help`);
  const about = el("small", { id: `${id}-help` }, help);
  return el("div", { class: "an-field" }, el("label", { for: id }, label), control, about);
}

function tick(label, help, control) {
  const id = newId();
  control.setAttribute("aria-describedby", id);
  return el("div", {}, el("label", { class: "an-check" }, control, el("span", {}, label)), el("small", { id }, help));
}

// The options of each kind; those of other kinds are hidden, and keep their values.
function optionFields(query) {
  const typed = { type: "text", autocomplete: "off", spellcheck: "false" };
  const rc = el("input", { ...typed, value: query.get("rc") || "auto" });
  const circuit = el("input", { ...typed, value: query.get("circuit") || "" });
  const objective = el(
    "select",
    {},
    ...WORDS.objectives.map(([value, words]) =>
      el("option", { value, selected: value === query.get("objective") }, words),
    ),
  );
  const drt = el("input", { type: "checkbox", checked: query.get("drt") !== "false" });
  const order = el("input", { ...typed, inputmode: "numeric", value: query.get("order") || "" });
  const parts = {
    fit: [
      field(WORDS.rc, WORDS.rcHelp, rc),
      field(WORDS.circuit, WORDS.circuitHelp, circuit),
      field(WORDS.objective, WORDS.objectiveHelp, objective),
    ],
    kk: [tick(WORDS.drt, WORDS.drtHelp, drt)],
    diagnose: [field(WORDS.order, WORDS.orderHelp, order)],
  };
  const groups = KINDS.map((kind) => [kind, el("div", {}, ...parts[kind])]);
  const node = el("fieldset", {}, el("legend", {}, WORDS.options), ...groups.map(([, group]) => group));
  const spare = (input) => input.value.replaceAll(" ", "");
  const rules = {
    fit: [rc, /^(all|auto|[1-8](,[1-8])*)$/, WORDS.rcWrong],
    diagnose: [order, /^[1-8]?$/, WORDS.orderWrong],
  };
  const values = {
    fit: () => ({
      ...(circuit.value.trim() ? { circuit: circuit.value.trim() } : { rc: spare(rc) }),
      ...(objective.value ? { objective: objective.value } : {}),
    }),
    kk: () => ({ drt: drt.checked }),
    diagnose: () => (spare(order) ? { order: Number(spare(order)) } : {}),
  };
  const mistake = (kind) => {
    if (!rules[kind]) return null;
    const [input, rule, words] = rules[kind];
    const fine = rule.test(spare(input));
    input.setAttribute("aria-invalid", String(!fine));
    return fine ? null : { words, field: input };
  };
  const show = (now) => groups.forEach(([kind, group]) => (group.hidden = kind !== now));
  return { node, show, mistake, values: (kind) => values[kind]() };
}

// Runs to select from: ticked runs stay selected during further searches.
function runChooser(mine, chosen) {
  const input = el("input", { type: "search", autocomplete: "off", spellcheck: "false" });
  const said = el("p", { class: "quiet", role: "status" });
  const list = el("ul", { class: "an-list", "aria-label": WORDS.runs, hidden: true });
  const more = el("button", { type: "button", hidden: true, onclick: () => search(cursor) }, WORDS.more);
  const count = el("p", {});
  const picked = el("ul", { class: "an-chosen", "aria-label": WORDS.runs });
  const node = el(
    "fieldset",
    {},
    el("legend", {}, WORDS.runs),
    count,
    picked,
    field(WORDS.search, WORDS.searchHelp, input),
    said,
    list,
    more,
  );
  const self = { node, field: input, changed: () => {} };
  let [cursor, asked, timer] = [null, 0, 0];
  const choose = (run, on) => {
    if (on) chosen.add(run);
    else chosen.delete(run);
    drawChosen();
    self.changed();
  };
  const box = (run) => {
    const tickBox = el("input", { type: "checkbox", checked: chosen.has(run.name) });
    tickBox.dataset.run = run.name;
    tickBox.addEventListener("change", () => choose(run.name, tickBox.checked));
    const verdict = WORDS.verdicts[run.verdict] || run.verdict;
    const words = el("span", {}, el("b", {}, run.name), ` ${verdict}`, el("small", {}, WORDS.run(run)));
    return el("li", {}, el("label", { class: "an-check" }, tickBox, words));
  };
  const remove = (run, place) => {
    choose(run, false);
    for (const one of list.querySelectorAll("input")) one.checked = chosen.has(one.dataset.run);
    const left = picked.querySelectorAll("button");
    (left[Math.min(place, left.length - 1)] || input).focus();
  };
  const drawChosen = () => {
    text(count, chosen.size ? WORDS.chosen(chosen.size) : WORDS.none);
    picked.hidden = !chosen.size;
    picked.replaceChildren(
      ...[...chosen].map((run, place) => {
        const label = `${WORDS.drop} ${run}`;
        const button = { type: "button", "aria-label": label, onclick: () => remove(run, place) };
        return el("li", {}, run, el("button", button, WORDS.drop));
      }),
    );
  };
  const search = async (after) => {
    const mark = (asked += 1);
    const query = new URLSearchParams({ text: input.value.trim(), most: String(FOUND) });
    if (after) query.set("after", after);
    text(said, WORDS.searching);
    try {
      const answer = await mine.ctx.get(`/catalog/runs?${query}`);
      if (mark !== asked || view !== mine) return;
      const boxes = answer.runs.map(box);
      if (after) list.append(...boxes);
      else list.replaceChildren(...boxes);
      cursor = answer.after;
      list.hidden = !list.children.length;
      const held = document.activeElement === more;
      more.hidden = !cursor;
      text(said, WORDS.found(list.children.length, Boolean(cursor)));
      if (after && held && boxes.length) boxes[0].querySelector("input").focus();
    } catch (error) {
      if (mark === asked) text(said, WORDS.failedLoad(error.message));
    }
  };
  input.addEventListener("input", () => {
    clearTimeout(timer);
    timer = setTimeout(search, SEARCH_MS);
  });
  input.addEventListener("keydown", (event) => {
    // Enter searches at once, and does not start the analysis.
    if (event.key !== "Enter") return;
    event.preventDefault();
    clearTimeout(timer);
    search();
  });
  drawChosen();
  return Object.assign(self, { search: () => search(), over: () => clearTimeout(timer) });
}

// Spectra of the selected runs, requested only when the list is unfolded.
function spectraChooser(mine, chosen) {
  const body = el("div", {});
  const node = el("details", {}, el("summary", {}, WORDS.spectra), el("small", {}, WORDS.spectraHelp), body);
  let asked = 0;
  const ticked = () => [...body.querySelectorAll("input:checked")].map((one) => one.value);
  const load = async () => {
    if (!node.open) return;
    const mark = (asked += 1);
    const before = ticked();
    if (!chosen.size) return body.replaceChildren(el("p", {}, WORDS.spectraFirst));
    const names = await mine.ctx.attempt(() => spectraNames(mine.ctx, chosen));
    if (mark !== asked || !names) return;
    body.replaceChildren(
      ...names.map((name) => {
        const box = { type: "checkbox", value: name, checked: before.includes(name) };
        return el("label", { class: "an-check" }, el("input", box), el("span", {}, name));
      }),
      names.length ? "" : el("p", {}, WORDS.spectraNone),
    );
  };
  node.addEventListener("toggle", load);
  return { node, reload: load, chosen: ticked };
}

async function spectraNames(ctx, runs) {
  const names = new Set();
  // One after the other: a browser gives each host few connections, and the stop needs one.
  for (const run of runs)
    for (const one of await ctx.get(`/runs/${encodeURIComponent(run)}/spectra`)) names.add(one.name);
  return [...names];
}

// ---- one of them --------------------------------------------------------------------------------

async function openOne(mine, id) {
  const heading = title(WORDS.loading);
  const body = el("div", { class: "an-view" });
  mine.root.append(heading, el("p", {}, el("a", { href: "#/analyses" }, `← ${WORDS.back}`)), body);
  heading.focus();
  let [page, newer] = [null, null];
  const put = (analysis) => {
    if (mine.heardOf) mine.heardOf(analysis);
    if (analysis.id !== id || view !== mine) return;
    newer = analysis;
    if (!page) {
      page = analysisPage(mine, analysis, heading);
      body.replaceChildren(page.node);
    }
    text(heading, nameOf(analysis));
    page.update(analysis);
    // An event may report the end without the results.
    if (isOver(analysis) && !analysis.files) mine.reload();
  };
  mine.putAnalysis = put;
  mine.put = put;
  mine.over = () => page && page.over();
  mine.reload = async () => {
    newer = null;
    try {
      const analysis = await mine.ctx.get(at(id));
      // An event that came meanwhile is newer.
      if (!newer) put(analysis);
      if (mine.loadOf) mine.loadOf();
    } catch (error) {
      if (view === mine && !page) notFound(mine, heading, body, id, error.message);
    }
  };
  await mine.reload();
}

// Opens a single investigation: its steps, and the button that cancels it.
async function openInvestigation(mine, id) {
  const heading = title(WORDS.loading);
  const body = el("section", {});
  mine.root.append(heading, el("p", {}, el("a", { href: "#/analyses" }, `← ${WORDS.back}`)), body);
  heading.focus();
  let [page, newer] = [null, null];
  mine.putAnalysis = (analysis) => page && page.heard(analysis);
  mine.putInvestigation = (one) => {
    if (one.id !== id || view !== mine) return;
    newer = one;
    if (!page) {
      page = investigationPart(mine, one, heading);
      body.replaceChildren(page.node);
    }
    text(heading, WORDS.investigationOf(one));
    page.update(one);
  };
  mine.reload = async () => {
    newer = null;
    try {
      const one = await mine.ctx.get(atInvestigation(id));
      // An event that came meanwhile is newer.
      if (!newer) mine.putInvestigation(one);
    } catch (error) {
      if (view === mine && !page) notFound(mine, heading, body, id, error.message);
    }
  };
  await mine.reload();
}

function investigationPart(mine, first, next) {
  const shown = investigationView(first);
  const cancel = canceller(mine.ctx, first, next, mine.putInvestigation, OF_INVESTIGATION);
  const node = el("div", {}, shown.node, el("div", { class: "acts" }, cancel.node));
  const update = (one) => {
    shown.update(one);
    cancel.update(one);
  };
  cancel.update(first);
  return { node, update, heard: shown.heard };
}

// Beside a diagnosis: the investigation that it belongs to, or an active one of its run; otherwise the form.
function investigationBeside(mine, analysis, heading) {
  const run = analysis.runs[0];
  const body = el("div", {});
  const node = el("section", {}, el("h3", {}, WORDS.investigation), body);
  let [page, shown] = [null, null];
  const isOurs = (one) => one.steps.some((step) => step.analysis === analysis.id) || (!one.ended && one.run === run);
  const put = (one) => {
    if (view !== mine || (shown ? shown !== one.id : !isOurs(one))) return;
    if (!page) {
      shown = one.id;
      page = investigationPart(mine, one, heading);
      body.replaceChildren(page.node);
    }
    page.update(one);
    // After its end, another investigation can start with another budget.
    if (one.ended && body.children.length === 1) body.append(investigationForm(mine.ctx, run, false));
  };
  const load = async () => {
    const all = await mine.ctx.get("/investigations").catch(() => []);
    if (view !== mine) return;
    all.filter(isOurs).slice(0, 1).forEach(put);
    if (!page && !body.hasChildNodes()) body.append(investigationForm(mine.ctx, run, false));
  };
  return { node, put, load, heard: (one) => page && page.heard(one) };
}

function notFound(mine, heading, body, id, message) {
  text(heading, WORDS.unknown(isInvestigation(id) ? WORDS.nouns.investigation : WORDS.nouns.analysis, id));
  const again = el("button", { type: "button", onclick: () => mine.reload() }, WORDS.again);
  body.replaceChildren(el("p", { class: "bad", role: "alert" }, WORDS.failedLoad(message)), again);
}

function analysisPage(mine, first, heading) {
  const state = el("p", { class: "an-state", role: "status" });
  const progress = progressBar(nameOf(first));
  progress.node.firstChild.remove();
  const facts = factList(first);
  const failure = el("div", { hidden: true });
  const cancel = canceller(mine.ctx, first, heading, mine.put);
  const log = logView(mine, first.id);
  const found = el("div", { class: "an-view" });
  const beside = first.kind === "diagnose" ? investigationBeside(mine, first, heading) : null;
  const node = el(
    "div",
    { class: "an-view" },
    el("section", {}, state, failure, progress.node, facts.node, el("div", { class: "acts" }, cancel.node)),
    found,
    beside ? beside.node : "",
    el("section", {}, commandLine(first), log.node, measured(mine, first)),
  );
  if (beside) {
    mine.putInvestigation = beside.put;
    mine.heardOf = beside.heard;
    mine.loadOf = beside.load;
  }
  let drawn = "";
  const update = (analysis) => {
    text(state, WORDS.states[analysis.state] || analysis.state);
    progress.node.hidden = isOver(analysis);
    progress.update(analysis);
    facts.update(analysis);
    cancel.update(analysis);
    drawFailure(failure, analysis);
    log.update(analysis);
    // Drawn only once, so that open sections and typed text survive.
    const isWhole = isOver(analysis) && analysis.files;
    const key = isWhole ? JSON.stringify([analysis.files, storiesOf(analysis)]) : drawn;
    if (key === drawn) return;
    drawn = key;
    drawFound(mine, found, analysis);
  };
  return { node, update, over: log.over };
}

function factList(first) {
  const names = Object.keys(WORDS.facts);
  const cells = Object.fromEntries(names.map((name) => [name, el("dd", {})]));
  const entries = names.flatMap((name) => [el("dt", {}, WORDS.facts[name]), cells[name]]);
  cells.runs.append(...linked(first.runs));
  const options = Object.entries(first.options).map(([name, value]) => `${name}: ${value}`);
  text(cells.options, options.join("; ") || WORDS.dash);
  text(cells.by, person(first.by));
  text(cells.begun, when(first.submitted_unix_s));
  text(cells.id, first.id);
  const update = (analysis) => {
    text(cells.ended, when(analysis.ended_unix_s));
    text(cells.left, isOver(analysis) ? WORDS.dash : WORDS.left(analysis.left_s));
  };
  return { node: el("dl", { class: "facts" }, ...entries), update };
}

function drawFailure(parent, analysis) {
  parent.hidden = !["failed", "cancelled"].includes(analysis.state);
  if (parent.hidden || parent.hasChildNodes()) return;
  if (analysis.state === "failed")
    parent.append(
      el("p", { class: "bad" }, el("b", {}, `${WORDS.failed}. `)),
      el("p", { class: "bad an-text" }, analysis.message || WORDS.noMessage),
    );
  else parent.append(el("p", {}, WORDS.wasCancelled, analysis.message ? ` ${analysis.message}` : ""));
}

// A campaign has a story of each cell.
const storiesOf = (analysis) => analysis.stories || (analysis.story ? [analysis.story] : []);

// The story first, pictures and numbers after it, all files last.
function drawFound(mine, parent, analysis) {
  const parts = [];
  const part = () => {
    parts.push(el("section", {}));
    return parts[parts.length - 1];
  };
  const stories = storiesOf(analysis);
  stories.forEach((story) => drawStory(part(), mine.ctx, story));
  drawPictures(part(), mine.ctx, analysis, nameOf(analysis), () => view === mine);
  drawResults(part(), mine.ctx, analysis, analysis.state === "done" && !stories.length);
  if (analysis.files.length) part().append(...drawFiles(mine.ctx, analysis));
  parent.replaceChildren(...parts.filter((one) => one.hasChildNodes()));
  parent.hidden = !parent.hasChildNodes();
}

function commandLine(analysis) {
  const code = el("code", { tabindex: 0 }, analysis.command);
  const said = el("span", { class: "quiet", role: "status" });
  const copy = async () => {
    try {
      await navigator.clipboard.writeText(analysis.command);
      text(said, WORDS.copied);
    } catch {
      // Only pages over https or of this machine may copy by themselves.
      getSelection().selectAllChildren(code);
      text(said, WORDS.notCopied);
    }
  };
  const button = el("button", { type: "button", onclick: copy }, WORDS.copy);
  return el("div", {}, el("h3", {}, WORDS.command), el("div", { class: "an-command" }, code, button), said);
}

// The log, requested while it is unfolded, at most every two seconds.
function logView(mine, id) {
  const lines = el("pre", { class: "an-pre an-log", tabindex: 0, role: "group", "aria-label": WORDS.log });
  const node = el("details", {}, el("summary", {}, WORDS.log), lines);
  let [timer, asked, state] = [0, 0, ""];
  const load = async () => {
    asked = Date.now();
    const all = await mine.ctx.get(`${at(id)}/log`).catch((error) => ({
      lines: [WORDS.failedLoad(error.message)],
    }));
    if (view !== mine) return;
    // If the user has scrolled up, the position stays.
    const below = lines.scrollHeight - lines.scrollTop - lines.clientHeight < 30;
    text(lines, all.lines.join("\n") || WORDS.logEmpty);
    if (below) lines.scrollTop = lines.scrollHeight;
  };
  const soon = () => {
    if (!node.open || timer) return;
    const wait = Math.max(0, asked + LOG_MS - Date.now());
    timer = setTimeout(() => {
      timer = 0;
      load();
    }, wait);
  };
  node.addEventListener("toggle", soon);
  const update = (analysis) => {
    if (analysis.state === "failed" && state !== "failed") node.open = true;
    // After the end the log no longer changes; the last lines are fetched once.
    if (!OVER.includes(state)) soon();
    state = analysis.state;
  };
  return { node, update, over: () => clearTimeout(timer) };
}

// The measured data, if the plots of spectra exist.
function measured(mine, analysis) {
  if (!window.eisCurves) return "";
  const body = el("div", {});
  const node = el("details", {}, el("summary", {}, WORDS.measured), body);
  let drawn = false;
  node.addEventListener("toggle", async () => {
    if (!node.open || drawn) return;
    drawn = true;
    const curves = await mine.ctx.attempt(() => curvesOf(mine.ctx, analysis.runs));
    drawn = Boolean(curves);
    if (!curves || view !== mine) return;
    if (!curves.length) return body.replaceChildren(el("p", {}, WORDS.measuredNone));
    window.eisCurves.panel(body).show({ curves, models: [] });
  });
  return node;
}

async function curvesOf(ctx, runs) {
  const all = [];
  for (const run of runs) {
    const spectra = await ctx.get(`/runs/${encodeURIComponent(run)}/spectra`);
    const corrected = spectra.filter((one) => one.corrected);
    for (const one of corrected.length ? corrected : spectra)
      all.push({ ...one, id: `${run}/${one.name}`, name: runs.length > 1 ? `${run}: ${one.name}` : one.name });
  }
  return all;
}
