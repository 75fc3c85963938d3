// Views `#/runs` (find runs and lay their spectra over each other) and `#/cells`, and what these share with the
// pages of one run and of one cell: tables of runs, verdicts in words, rows that keep the focus.
"use strict";

import { el, fill, person, text, when } from "./bench.js";

const WORDS = {
  runs: "Runs",
  cells: "Cells",
  fields: {
    text: "Free text",
    cell: "Cell",
    bench: "Bench",
    verdict: "Verdict",
    tag: "Tag",
    from: "From day",
    to: "To day",
  },
  hint: "name, experiment, note …",
  any: "any",
  find: "Find",
  clear: "Show all",
  copy: "Copy link",
  copied: "The link is copied.",
  copyByHand: "This browser lets no page copy; the link is selected, copy it by hand.",
  link: "Link to what is found",
  more: "Show more",
  results: "Runs found",
  columns: {
    compare: "Compare",
    run: "Run",
    bench: "Bench",
    experiment: "Experiment",
    cells: "Cells",
    when: "Submitted",
    by: "By",
    how: "How it ended",
    verdict: "Verdict",
    tags: "Tags",
    notes: "Notes",
  },
  campaign: "campaign",
  looking: "Looking …",
  daysSwapped: "No run found: the first day lies after the last one.",
  noRun: "No run found.",
  found: (count, more, shown) =>
    `${more ? "More than " : ""}${count} ${count === 1 ? "run" : "runs"} found, ${shown} shown.`,
  compareRun: (run) => `Compare ${run}`,
  compareHint: (most) => `Tick up to ${most} runs to lay their spectra over each other.`,
  full: (most) => `${most} runs are ticked, which is the most: take one out to tick another.`,
  compared: "Spectra compared",
  takeOut: (run) => `Take out ${run}`,
  loading: "The spectra are being loaded …",
  overlay: (curves, runs) =>
    `${curves} ${curves === 1 ? "spectrum" : "spectra"} of ${runs} ${runs === 1 ? "run" : "runs"}.`,
  left: (n) => ` ${n} more are left out to keep the plot readable.`,
  without: (runs) => ` Without a spectrum: ${runs.join(", ")}.`,
  notLoaded: (runs) => ` Could not be loaded: ${runs.join(", ")}.`,
  noPlots: "The part of the page that draws spectra is missing; reload the page.",
  unknown: "–",
  noCell: "No cell was measured yet.",
  cellCount: (n) => `${n} ${n === 1 ? "cell" : "cells"}.`,
  cellColumns: { cell: "Cell", serial: "Serial number", runs: "Runs", first: "First measured", last: "Last measured" },
  cellRuns: (n, cell) => `${n} ${n === 1 ? "run" : "runs"} with ${cell}`,
  serial: (cell) => `${cell.name}${cell.serial ? ` (${cell.serial})` : ""}`,
  lack: (scope, have) => `needs the scope ${scope}; your token has ${have.length ? have.join(", ") : "none"}`,
  verdicts: {
    good: ["✓", "good", "good"],
    doubtful: ["▲", "doubtful", "note"],
    failed: ["✕", "failed", "bad"],
    "in work": ["▶", "in work", "on"],
  },
};

const SCOPES = ["read", "operate", "energise", "clear-trip"];
const MOST_RUNS = 12;
// So many curves can still be told from each other.
const MOST_CURVES = 24;
// So many rows are added at a time; so many are asked for, so that they can be counted.
const ROWS = 20;
const ASKED = 100;
const TYPING_MS = 300;
// Events come in bursts; the lists are asked for again no more often than this.
export const CALM_MS = 1000;

let view = null;

// ---- shared -------------------------------------------------------------------------------------

export const address = (...parts) => `#/${parts.map(encodeURIComponent).join("/")}`;

// Why a person may not do something, in words; null where they may.
export function lack(ctx, scope) {
  return ctx.may(scope)
    ? null
    : WORDS.lack(
        scope,
        SCOPES.filter((one) => ctx.may(one)),
      );
}

// A verdict as a sign, a word and a colour.
export function verdict(name) {
  const [sign, words, colour] = WORDS.verdicts[name] || ["?", name, "quiet"];
  return el("span", { class: `fd-verdict ${colour}` }, el("span", { "aria-hidden": "true" }, `${sign} `), words);
}

// What a spectrum is called in words: `raw_fake_cell` is the fake cell, `spectra/A_1` is A 1.
export const named = (name) => name.replace(/^spectra\//, "").replace(/^raw_/, "").replaceAll("_", " ");

// Does `work` a second after `now()` was called first, however often it is called until then.
export function calmly(work) {
  let timer = 0;
  return {
    now() {
      timer ||= setTimeout(() => {
        timer = 0;
        work();
      }, CALM_MS);
    },
    end: () => clearTimeout(timer),
  };
}

const CONTROLS = "a[href], button:not(:disabled), input:not(:disabled), select:not(:disabled), textarea:not(:disabled)";
export const controls = (node) => [...node.querySelectorAll(CONTROLS)];

// Where the focus is within `parent`: in which row, and at which control of it.
function heldIn(parent) {
  const row = [...parent.children].find((one) => one.contains(document.activeElement));
  if (!row) return null;
  const node = document.activeElement;
  const place = [...parent.children].indexOf(row);
  return { node, key: row.dataset.key, place, control: controls(row).indexOf(node) };
}

function hold(parent, held, spare) {
  if (!held || document.activeElement === held.node) return;
  const rows = [...parent.children];
  const row = rows.find((one) => one.dataset.key === held.key) || rows[Math.min(held.place, rows.length - 1)];
  const found = held.node.isConnected ? [held.node] : row ? controls(row) : [];
  const next = found[held.control] || found[0] || spare;
  if (next) next.focus({ preventScroll: true });
}

// Brings the rows of `parent` to what `items` say. A row that looks the same stays the same node, so that focus,
// scroll and a press of a button survive; where the row in focus goes, its neighbour or `spare` gets the focus.
export function keyed(parent, items, key, draw, spare = null) {
  const held = heldIn(parent);
  const old = new Map([...parent.children].map((node) => [node.dataset.key, node]));
  const nodes = items.map((item, place) => {
    const next = draw(item);
    next.dataset.key = key(item, place);
    const was = old.get(next.dataset.key);
    return was && was.isEqualNode(next) ? was : next;
  });
  const stay = new Set(nodes);
  for (const node of [...parent.children]) if (!stay.has(node)) node.remove();
  nodes.forEach((node, place) => {
    if (parent.children[place] !== node) parent.insertBefore(node, parent.children[place] || null);
  });
  hold(parent, held, spare);
}

// A table within its own frame that scrolls, and is a list of cards on a phone; `body` is its tbody.
export function table(label, heads, body) {
  const head = el("tr", {}, ...heads.map((words) => el("th", { scope: "col" }, words)));
  return el(
    "div",
    { class: "scroll stack fd-cards", tabindex: "0", role: "region", "aria-label": label },
    el("table", {}, el("thead", {}, head), body),
  );
}

export const cell = (name, ...children) => el("td", { "data-name": name }, ...children);
// Of names, which may be long and are broken where need be, but not into single letters.
const names = (name, ...children) => cell(name, el("div", { class: "fd-name" }, ...children));

// A view begins with its heading, which gets the focus; `parts` follow it.
export function begin(parent, title, ...parts) {
  const heading = el("h2", { tabindex: "-1" }, title);
  const root = el("div", { class: "fd-view" }, heading, ...parts);
  parent.replaceChildren(root);
  heading.focus({ preventScroll: true });
  return root;
}

// The heads of a table of runs, and its rows.
export const runHeads = () => Object.values(WORDS.columns).slice(1);

export function runCells(card) {
  const heads = WORDS.columns;
  return [
    el(
      "th",
      { scope: "row" },
      el("div", { class: "fd-name" }, el("a", { href: address("run", card.run) }, card.run)),
      card.campaign ? el("small", {}, WORDS.campaign) : null,
    ),
    names(heads.bench, el("a", { href: `#${encodeURIComponent(card.bench)}` }, card.bench)),
    names(heads.experiment, card.experiment),
    names(heads.cells, ...cellLinks(card.cells)),
    cell(heads.when, when(card.submitted_unix_s)),
    names(heads.by, person(card.by)),
    names(heads.how, card.how),
    cell(heads.verdict, verdict(card.verdict)),
    names(heads.tags, ...card.tags.map((tag) => el("span", { class: "fd-tag" }, tag))),
    cell(heads.notes, String(card.notes)),
  ];
}

export const cellLinks = (cells) =>
  cells.flatMap((one, place) => {
    const link = el("a", { href: address("cell", one.name) }, WORDS.serial(one));
    return [el("span", { class: "fd-one" }, link, place < cells.length - 1 ? "," : ""), " "];
  });

// Spectra of runs, each asked for once.
export function shelf(ctx) {
  const kept = new Map();
  return {
    of(run) {
      if (!kept.has(run)) {
        const asked = ctx.get(`/runs/${encodeURIComponent(run)}/spectra`);
        asked.catch(() => kept.delete(run));
        kept.set(run, asked);
      }
      return kept.get(run);
    },
    forget: (run) => kept.delete(run),
  };
}

// A curve as the panel wants it, and as a point of it is asked for.
export const curve = (run, spectrum, name) => ({
  ...spectrum,
  id: JSON.stringify([run, spectrum.name]),
  run,
  spectrum: spectrum.name,
  name,
});

// The panel that draws spectra; it keeps to the width of `parent` by itself.
export function plot(parent, onPoint) {
  if (window.eisCurves) return window.eisCurves.panel(parent, { onPoint });
  parent.replaceChildren(el("p", { class: "bad" }, WORDS.noPlots));
  return { show: () => {} };
}

// ---- the form -----------------------------------------------------------------------------------

const FIELDS = Object.keys(WORDS.fields);

function field(name, query) {
  const kinds = { text: "search", from: "date", to: "date" };
  const value = query.get(name) || "";
  const input = kinds[name]
    ? el("input", { name, type: kinds[name], value, placeholder: name === "text" ? WORDS.hint : null })
    : el("select", { name });
  if (!kinds[name]) choices(input, name === "verdict" ? Object.keys(WORDS.verdicts) : [], value);
  return el("label", {}, WORDS.fields[name], input);
}

// What can be chosen. What is chosen stays, for a link may name what is no more.
function choices(select, values, chosen = select.value) {
  const all = [...new Set([...(chosen ? [chosen] : []), ...values])].sort((a, b) => a.localeCompare(b));
  const key = JSON.stringify(all);
  if (select.dataset.values !== key) {
    select.replaceChildren(new Option(WORDS.any, ""), ...all.map((one) => new Option(one, one)));
    select.dataset.values = key;
  }
  select.value = chosen;
}

// What the form asks for, as it stands in the address.
function asked(form) {
  const filled = FIELDS.filter((name) => form.elements[name].value.trim());
  return new URLSearchParams(filled.map((name) => [name, form.elements[name].value.trim()]));
}

// The midnight, local time, at which a day begins, or so many days later, s since 1970.
function midnight(day, later) {
  const [year, month, date] = day.split("-").map(Number);
  return new Date(year, month - 1, date + later).getTime() / 1e3;
}

// The same as the server wants it: whole days as seconds.
function request(form) {
  const query = asked(form);
  const [from, to] = [query.get("from"), query.get("to")];
  query.delete("from");
  query.delete("to");
  if (from) query.set("from_s", midnight(from, 0));
  if (to) query.set("to_s", midnight(to, 1));
  query.set("most", ASKED);
  return query;
}

function here(form) {
  const query = asked(form).toString();
  return `#/runs${query ? `?${query}` : ""}`;
}

// Where the page may not copy, for which browsers want https, the link is shown to be copied by hand.
async function copy() {
  const link = location.href;
  try {
    await navigator.clipboard.writeText(link);
    text(view.copied, WORDS.copied);
  } catch {
    text(view.copied, WORDS.copyByHand);
    view.link.hidden = false;
    const input = view.link.querySelector("input");
    input.value = link;
    input.focus();
    input.select();
  }
}

function form(query) {
  const button = (words, onclick) => el("button", { type: "button", onclick }, words);
  const clear = () => {
    for (const name of FIELDS) view.form.elements[name].value = "";
    search();
  };
  view.form = el(
    "form",
    {
      class: "fd-form",
      role: "search",
      onsubmit: (event) => {
        event.preventDefault();
        search();
      },
      oninput: () => {
        clearTimeout(view.typing);
        view.typing = setTimeout(search, TYPING_MS);
      },
    },
    ...FIELDS.map((name) => field(name, query)),
    el("div", { class: "acts" }, el("button", {}, WORDS.find), button(WORDS.clear, clear), button(WORDS.copy, copy)),
  );
  view.copied = el("p", { class: "quiet fd-line", role: "status" });
  // Not within the form: it is nothing to search for.
  view.link = el("label", { class: "fd-link", hidden: true }, WORDS.link, el("input", { readonly: true }));
  return el("section", {}, view.form, view.copied, view.link);
}

// ---- finding ------------------------------------------------------------------------------------

// Asks until there are `least` runs or no more; from a cursor on, if there is one.
async function collect(least, after) {
  const query = request(view.form);
  const all = { found: [], more: after };
  do {
    if (all.more) query.set("after", all.more);
    const part = await view.ctx.get(`/runs/find?${query}`);
    Object.assign(all, part, { found: [...all.found, ...part.found] });
  } while (all.more && all.found.length < least);
  return all;
}

// Finds what the form says; an answer that comes late is dropped.
async function search() {
  const mine = view;
  clearTimeout(mine.typing);
  history.replaceState(history.state, "", here(mine.form));
  text(mine.copied, "");
  mine.link.hidden = true;
  const turn = (mine.turn += 1);
  const got = await mine.ctx.attempt(() => collect(1, null));
  if (!got || view !== mine || turn !== mine.turn) return;
  mine.shown = ROWS;
  take(got, []);
}

// The same once more after an event, as many as there were.
async function again() {
  const mine = view;
  const turn = (mine.turn += 1);
  const got = await collect(mine.found.length, null).catch(() => null);
  if (got && view === mine && turn === mine.turn) take(got, []);
}

async function more() {
  const mine = view;
  const before = mine.shown;
  if (before + ROWS > mine.found.length && mine.more) {
    const turn = (mine.turn += 1);
    const got = await mine.ctx.attempt(() => collect(1, mine.more));
    if (!got || view !== mine || turn !== mine.turn) return;
    take(got, mine.found);
  }
  mine.shown = before + ROWS;
  drawFound();
  const first = mine.rows.children[before];
  if (mine.moreButton.hidden && first) first.querySelector("a").focus();
}

function take(got, before) {
  const known = new Set(before.map((card) => card.run));
  view.found = [...before, ...got.found.filter((card) => !known.has(card.run))];
  view.more = got.more;
  view.number = got.number;
  choices(view.form.elements.cell, got.cells);
  choices(view.form.elements.bench, got.benches);
  choices(view.form.elements.tag, got.tags);
  drawFound();
}

function told(shown) {
  const { from, to } = view.form.elements;
  // The server tells the number of all; one that does not is known by what was asked for.
  const number = view.number ?? view.found.length;
  if (view.found.length) return WORDS.found(number, view.more && number === view.found.length, shown);
  return from.value && to.value && from.value > to.value ? WORDS.daysSwapped : WORDS.noRun;
}

function drawFound() {
  const cards = view.found.slice(0, view.shown);
  const full = view.ticked.size >= MOST_RUNS;
  keyed(
    view.rows,
    cards,
    (card) => card.run,
    (card) => el("tr", {}, cell(WORDS.columns.compare, tick(card.run, full)), ...runCells(card)),
    view.form.elements.text,
  );
  // A box that was ticked is the same node, and is told here: what it shows is no attribute.
  for (const box of view.rows.querySelectorAll("input")) box.checked = view.ticked.has(box.value);
  view.results.hidden = !cards.length;
  text(view.full, full ? WORDS.full(MOST_RUNS) : WORDS.compareHint(MOST_RUNS));
  text(view.said, told(cards.length));
  view.moreButton.hidden = cards.length >= view.found.length && !view.more;
}

function tick(run, full) {
  return el("input", {
    type: "checkbox",
    value: run,
    "aria-label": WORDS.compareRun(run),
    "aria-describedby": "fd-full",
    disabled: full && !view.ticked.has(run),
    onchange: (event) => {
      if (event.target.checked) view.ticked.add(run);
      else view.ticked.delete(run);
      drawFound();
      compare();
    },
  });
}

// ---- comparing ----------------------------------------------------------------------------------

const corrected = (spectra) => {
  const found = spectra.filter((one) => one.corrected);
  return found.length ? found : spectra;
};

function drawTicked() {
  view.compared.hidden = !view.ticked.size;
  keyed(
    view.chips,
    [...view.ticked],
    (run) => run,
    (run) =>
      el(
        "li",
        {},
        el("a", { href: address("run", run) }, run),
        el("button", { type: "button", "aria-label": WORDS.takeOut(run), onclick: () => untick(run) }, "✕"),
      ),
    view.rows.querySelector("input") || view.form.elements.text,
  );
}

function untick(run) {
  view.ticked.delete(run);
  drawFound();
  compare();
}

// Loads the spectra of what is ticked, and no other, and draws them.
async function compare() {
  const mine = view;
  drawTicked();
  if (!mine.ticked.size) return;
  mine.panel ||= plot(mine.holder);
  const turn = (mine.comparison += 1);
  const runs = [...mine.ticked];
  const late = setTimeout(() => text(mine.overlaid, WORDS.loading), TYPING_MS);
  const got = await Promise.all(runs.map((run) => mine.shelf.of(run).catch(() => null)));
  clearTimeout(late);
  if (view === mine && turn === mine.comparison) overlay(runs, got);
}

function overlay(runs, got) {
  const each = Math.max(1, Math.floor(MOST_CURVES / runs.length));
  const spectra = got.map((one) => corrected(one || []));
  const curves = runs.flatMap((run, place) =>
    spectra[place].slice(0, each).map((one) => curve(run, one, `${run}: ${named(one.name)}`)),
  );
  view.panel.show({ curves, models: [] });
  const left = spectra.reduce((sum, one) => sum + Math.max(0, one.length - each), 0);
  const failed = runs.filter((_, place) => !got[place]);
  const empty = runs.filter((_, place) => got[place] && !got[place].length);
  text(
    view.overlaid,
    WORDS.overlay(curves.length, runs.length) +
      (left ? WORDS.left(left) : "") +
      (empty.length ? WORDS.without(empty) : "") +
      (failed.length ? WORDS.notLoaded(failed) : ""),
  );
}

// ---- the views ----------------------------------------------------------------------------------

async function openRuns(parent, query) {
  Object.assign(view, { found: [], more: null, shown: ROWS, turn: 0, comparison: 0 });
  Object.assign(view, { ticked: new Set(), shelf: shelf(view.ctx), calm: calmly(again), calmCurves: calmly(compare) });
  view.rows = el("tbody", {});
  view.said = el("p", { role: "status" }, WORDS.looking);
  view.full = el("p", { class: "quiet", id: "fd-full" });
  view.moreButton = el("button", { type: "button", hidden: true, onclick: more }, WORDS.more);
  view.results = el("div", { hidden: true }, view.full, table(WORDS.results, Object.values(WORDS.columns), view.rows));
  view.chips = el("ul", { class: "fd-chips" });
  view.holder = el("div", {});
  view.overlaid = el("p", { class: "quiet", role: "status" });
  view.compared = el(
    "section",
    { hidden: true, "aria-labelledby": "fd-compared" },
    el("h3", { id: "fd-compared" }, WORDS.compared),
    view.chips,
    view.overlaid,
    view.holder,
  );
  begin(
    parent,
    WORDS.runs,
    form(query),
    el("section", {}, view.said, view.results, el("div", { class: "acts" }, view.moreButton)),
    view.compared,
  );
  await search();
}

async function openCells(parent) {
  view.rows = el("tbody", {});
  view.said = el("p", { role: "status" }, WORDS.looking);
  view.results = table(WORDS.cells, Object.values(WORDS.cellColumns), view.rows);
  view.results.hidden = true;
  view.calm = calmly(() => view.ctx.get("/cells").then(drawCells, () => {}));
  begin(parent, WORDS.cells, el("section", {}, view.said, view.results));
  const mine = view;
  const cells = await mine.ctx.attempt(() => mine.ctx.get("/cells"));
  if (cells && view === mine) drawCells(cells);
}

const runsOf = (cell) => `#/runs?${new URLSearchParams({ cell })}`;

function drawCells(cells) {
  const heads = WORDS.cellColumns;
  const row = (one) =>
    el(
      "tr",
      {},
      el("th", { scope: "row" }, el("a", { href: address("cell", one.cell) }, one.cell)),
      cell(heads.serial, one.serial || WORDS.unknown),
      cell(
        heads.runs,
        el("a", { href: runsOf(one.cell), "aria-label": WORDS.cellRuns(one.runs, one.cell) }, String(one.runs)),
      ),
      cell(heads.first, when(one.first_unix_s)),
      cell(heads.last, when(one.last_unix_s)),
    );
  keyed(view.rows, cells, (one) => one.cell, row);
  view.results.hidden = !cells.length;
  text(view.said, cells.length ? WORDS.cellCount(cells.length) : WORDS.noCell);
}

export async function open(parent, where, ctx) {
  view = { kind: where.path[0], ctx };
  if (view.kind === "cells") await openCells(parent);
  else await openRuns(parent, where.query);
}

export function heard(kind, data) {
  if (!view) return;
  if (kind === "run" || kind === "hello" || kind === "lost") view.calm.now();
  // The curve of a run that is compared grows, or is corrected in the end.
  const run = kind === "spectrum" ? data.run : kind === "run" ? data.item.run : "";
  if (view.ticked && view.ticked.has(run)) {
    view.shelf.forget(run);
    view.calmCurves.now();
  }
}

export function close() {
  if (!view) return;
  clearTimeout(view.typing);
  for (const calm of [view.calm, view.calmCurves]) if (calm) calm.end();
  view = null;
}
