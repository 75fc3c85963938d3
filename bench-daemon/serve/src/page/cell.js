// View `#/cell/NAME`: the ageing of a cell: fitted models and resistances over time, its spectra by age, its runs, and
// its notes.
"use strict";

import { el, fill, minus, text, when } from "./bench.js";
import {
  address,
  begin,
  calmly,
  cell,
  curve,
  keyed,
  named,
  runCells,
  runHeads,
  shelf,
  table,
  verdict,
} from "./find.js";
import { ageing } from "./ageing.js";
import { notes } from "./notes.js";
import { bar, noCharts, overTime } from "./overtime.js";
import { comparing } from "./run.js";

const WORDS = {
  title: (name) => `Cell ${name}`,
  looking: "Looking …",
  missing: (name) => `No run has measured a cell ${name}.`,
  serials: (all) => `Serial ${all.length === 1 ? "number" : "numbers"}: ${all.join(", ")}.`,
  noSerial: "No serial number is known.",
  count: (n) => `${n} ${n === 1 ? "spectrum" : "spectra"} measured.`,
  curve: (date, run, repeat) => `${date} ${run}, repeat ${repeat}`,
  history: "Resistance over time",
  high: "R high",
  low: "R low",
  highHint: "R high: the real part where the imaginary part changes its sign, else at the highest frequency.",
  lowHint: "R low: the real part at the lowest frequency.",
  lowDiffers: (values) => `The lowest frequency is not the same in all: ${values}. Compare like with like.`,
  highDiffers: "The table shows where R high was read.",
  bars: "Bars: ±2σ. ● good, △ doubtful, ✕ failed or stopped. The table has the same figures.",
  axis: (name) => `${name} / mΩ`,
  unit: "mΩ",
  noHistory: "No spectrum yet.",
  trend: (name, first, last, change) => `${name}: ${first} at first, ${last} at last (${change}). `,
  columns: {
    show: "Show",
    when: "When",
    run: "Run",
    repeat: "Repeat",
    bench: "Bench",
    verdict: "Verdict",
    high: "R high ± 2σ",
    atHigh: "R high at",
    low: "R low ± 2σ",
    atLow: "R low at",
  },
  historyTable: "Resistances and spectra of this cell",
  show: (name) => `Show the spectrum ${name}`,
  unknown: "–",
  spectra: "Spectra over age",
  choose: (most) => `Tick up to ${most} spectra in this table to see them below it.`,
  full: (most) => `${most} spectra are ticked, which is the maximum: untick one to tick another.`,
  shown: (n) => `${n} ${n === 1 ? "spectrum is" : "spectra are"} shown.`,
  lost: (names) => ` Could not be loaded: ${names.join(", ")}.`,
  loading: "The spectra are being loaded …",
  runs: "Runs",
  noRun: "No run yet.",
  runTable: "Runs of this cell",
};

const MOST_CURVES = 12;
// Number of rows that are requested at a time.
const ASKED = 1000;
// Initial number of spectra: first, latest, and evenly spaced ones between them.
const AT_FIRST = 8;
const LATE_MS = 300;
const CHARTS = [
  ["high", "r_high_ohm", "r_high_sigma_ohm", "r_high_hz", "--c0"],
  ["low", "r_low_ohm", "r_low_sigma_ohm", "low_hz", "--c1"],
];

let view = null;

const path = (...more) => ["/cells", encodeURIComponent(view.name), ...more].join("/");
const keyOf = (one) => JSON.stringify([one.run, one.spectrum]);
const milli = (ohm) => (Number.isFinite(ohm) ? (1e3 * ohm).toPrecision(4) : WORDS.unknown);
const hertz = (value) => (Number.isFinite(value) ? `${Number(value.toPrecision(3))} Hz` : WORDS.unknown);

// Display name of a measurement of the cell: its date first, because the view shows ageing.
const title = (one) => WORDS.curve(when(one.unix_s).slice(0, 16), one.run, one.repeat);

// ---- resistance over time -----------------------------------------------------------------------

function drawCharts() {
  if (noCharts()) return;
  for (const [place, [name, value, sigma, , colour]] of CHARTS.entries()) {
    view.charts[place] ||= overTime(view.holders[place], { name: WORDS.axis(WORDS[name]), axis: WORDS.unit, colour });
    const point = (one) => ({
      unix_s: one.unix_s,
      ...bar({ value: one[value], sigma: Number.isFinite(one[sigma]) ? 2 * one[sigma] : null }, 1e3),
      mark: one.verdict,
      joined: true,
      href: address("run", one.run),
    });
    view.charts[place].show(view.history.filter((one) => Number.isFinite(one[value])).map(point));
  }
}

// Describes the charts as text.
function trend() {
  const words = CHARTS.map(([name, value]) => {
    const known = view.history.filter((one) => Number.isFinite(one[value]));
    if (known.length < 2) return "";
    const [first, last] = [known[0][value], known[known.length - 1][value]];
    const percent = minus((100 * (last / first - 1)).toFixed(1));
    const change = `${last > first ? "+" : ""}${percent} %`;
    return WORDS.trend(WORDS[name], `${milli(first)} mΩ`, `${milli(last)} mΩ`, change);
  });
  return words.join("").trim();
}

// Frequencies that differ by more than a rounding, the lowest first.
function lowest() {
  const all = view.history.map((one) => one.low_hz).filter(Number.isFinite);
  return [...new Set([...all].sort((a, b) => a - b).map(hertz))];
}

function drawHints() {
  const lows = lowest();
  const lines = [
    trend(),
    `${WORDS.highHint} ${WORDS.highDiffers}`,
    `${WORDS.lowHint}${lows.length > 1 ? ` ${WORDS.lowDiffers(lows.join(", "))}` : ""}`,
    WORDS.bars,
  ];
  fill(view.hints, ...lines.filter(Boolean).map((line) => el("p", { class: "quiet" }, line)));
}

// ---- the table ----------------------------------------------------------------------------------

function drawTable() {
  const heads = WORDS.columns;
  const full = view.ticked.size >= MOST_CURVES;
  const figure = (one, [, value, sigma]) =>
    `${milli(one[value])}${Number.isFinite(one[sigma]) ? ` ± ${(2e3 * one[sigma]).toPrecision(2)}` : ""} mΩ`;
  const row = (one) =>
    el(
      "tr",
      {},
      cell(heads.show, box(one, full)),
      el("th", { scope: "row" }, when(one.unix_s)),
      cell(heads.run, el("a", { href: address("run", one.run) }, one.run)),
      cell(heads.repeat, String(one.repeat)),
      cell(heads.bench, one.bench),
      cell(heads.verdict, verdict(one.verdict)),
      cell(heads.high, figure(one, CHARTS[0])),
      cell(heads.atHigh, hertz(one.r_high_hz)),
      cell(heads.low, figure(one, CHARTS[1])),
      cell(heads.atLow, hertz(one.low_hz)),
    );
  // The latest entries come first, because they matter most.
  keyed(view.rows, [...view.history].reverse(), keyOf, row);
  for (const input of view.rows.querySelectorAll("input")) input.checked = view.ticked.has(input.value);
  text(view.choose, full ? WORDS.full(MOST_CURVES) : WORDS.choose(MOST_CURVES));
}

function box(one, full) {
  const key = keyOf(one);
  return el("input", {
    type: "checkbox",
    value: key,
    "aria-label": WORDS.show(title(one)),
    "aria-describedby": "fd-choose",
    disabled: full && !view.ticked.has(key),
    onchange: (event) => {
      view.byHand = true;
      if (event.target.checked) view.ticked.add(key);
      else view.ticked.delete(key);
      drawTable();
      drawSpectra();
    },
  });
}

// ---- spectra over age ---------------------------------------------------------------------------

// The first, the latest, and some between at even distances.
function preferred() {
  const all = view.history;
  const many = Math.min(AT_FIRST, all.length);
  const places = Array.from({ length: many }, (_, k) => Math.round((k * (all.length - 1)) / Math.max(1, many - 1)));
  return new Set(places.map((place) => keyOf(all[place])));
}

// Loads the ticked spectra, and draws them from the oldest to the latest.
async function drawSpectra() {
  const mine = view;
  const chosen = mine.history.filter((one) => mine.ticked.has(keyOf(one)));
  mine.panel ||= comparing(mine.ctx, mine.spectraHolder);
  const turn = (mine.turn += 1);
  const late = setTimeout(() => text(mine.spectraSaid, WORDS.loading), LATE_MS);
  const got = await Promise.all(chosen.map((one) => mine.shelf.of(one.run).catch(() => [])));
  clearTimeout(late);
  if (view !== mine || turn !== mine.turn) return;
  const lost = [];
  const curves = chosen.flatMap((one, place) => {
    const found = got[place].find((spectrum) => spectrum.name === one.spectrum);
    if (!found) lost.push(`${one.run} (${named(one.spectrum)})`);
    return found ? [curve(one.run, found, title(one))] : [];
  });
  mine.panel.show({ curves, models: [] });
  text(mine.spectraSaid, WORDS.shown(curves.length) + (lost.length ? WORDS.lost(lost) : ""));
}

// ---- the view -----------------------------------------------------------------------------------

function drawRuns(runs) {
  keyed(
    view.runs,
    runs,
    (run) => run.run,
    (run) => el("tr", {}, ...runCells(run)),
  );
  view.runTable.hidden = !runs.length;
  view.noRun.hidden = runs.length > 0;
}

function take(got) {
  view.history = got.spectra.filter((one) => one.bias_a === 0 && one.cell === view.name).map(moment);
  view.history.sort((a, b) => a.unix_s - b.unix_s);
  const there = new Set(view.history.map(keyOf));
  view.ticked = view.byHand ? new Set([...view.ticked].filter((key) => there.has(key))) : preferred();
  const known = got.cells.filter((one) => one.cell === view.name && one.serial).map((one) => one.serial);
  const serials = known.length ? WORDS.serials(known) : WORDS.noSerial;
  text(view.said, `${serials} ${WORDS.count(view.history.length)}`);
  view.body.hidden = view.spectraSection.hidden = !view.history.length;
  view.none.hidden = view.history.length > 0;
  drawRuns(got.runs);
  view.notes.take(got.notes);
  if (!view.history.length) return;
  drawCharts();
  drawHints();
  drawTable();
  drawSpectra();
}

// Returns all rows of the catalogue for this cell.
async function ask(mine, kind) {
  const query = new URLSearchParams({ cell: mine.name, most: ASKED });
  const rows = [];
  for (let after = ""; after !== null; ) {
    if (after) query.set("after", after);
    const got = await mine.ctx.get(`/catalog/${kind}?${query}`);
    rows.push(...got[kind]);
    after = got.after;
  }
  return rows;
}

// A spectrum of the catalogue as a moment of the history.
function moment(one) {
  return {
    ...one,
    run: one.name,
    unix_s: one.started_unix_s,
    spectrum: one.file.replace(/\.csv$/, ""),
    verdict: one.refused_points ? "doubtful" : "good",
  };
}

async function load() {
  const mine = view;
  const rows = ["spectra", "cells", "runs"].map((kind) => ask(mine, kind));
  const [spectra, cells, runs, said] = await Promise.all([...rows, mine.ctx.get(path("notes"))]);
  if (view === mine) take({ spectra, cells, runs, notes: said });
}

// Refreshes after an event. The catalogue follows the end of a run automatically.
function again() {
  load().catch(() => {});
  view.ageing.refresh();
}

function section(id, words, ...parts) {
  return el("section", { "aria-labelledby": id }, el("h3", { id }, words), ...parts);
}

function chartFigure([name]) {
  const holder = el("div", { "aria-hidden": "true" });
  view.holders.push(holder);
  return el("figure", {}, el("figcaption", { class: "fd-caption" }, WORDS[name]), holder);
}

function historySection() {
  view.rows = el("tbody", {});
  view.hints = el("div", {});
  view.choose = el("p", { class: "quiet", id: "fd-choose" });
  view.none = el("p", { class: "quiet" }, WORDS.looking);
  const shown = table(WORDS.historyTable, Object.values(WORDS.columns), view.rows);
  shown.classList.add("fd-tall");
  const pair = el("div", { class: "fd-pair" }, ...CHARTS.map(chartFigure));
  const lacking = noCharts() ? el("p", { class: "bad" }, noCharts()) : null;
  view.body = el("div", { hidden: true }, lacking, pair, view.hints, view.choose, shown);
  return section("fd-history", WORDS.history, view.none, view.body);
}

function build(parent) {
  view.said = el("p", { role: "status" }, WORDS.looking);
  view.spectraHolder = el("div", {});
  view.spectraSaid = el("p", { class: "quiet", role: "status" });
  view.spectraSection = section("fd-spectra", WORDS.spectra, view.spectraSaid, view.spectraHolder);
  view.spectraSection.hidden = true;
  view.runs = el("tbody", {});
  view.runTable = table(WORDS.runTable, runHeads(), view.runs);
  view.runTable.classList.add("fd-tall");
  view.runTable.hidden = true;
  view.noRun = el("p", { class: "quiet" }, WORDS.noRun);
  const said = el("section", {});
  view.ageing = ageing(view.name, view.serial, view.ctx);
  view.root = begin(
    parent,
    WORDS.title(view.name),
    view.said,
    view.ageing.node,
    historySection(),
    view.spectraSection,
    section("fd-runs", WORDS.runs, view.noRun, view.runTable),
    said,
  );
  view.notes = notes(said, path("notes"), view.ctx);
}

// First load. The page shows a message for a cell without measurements.
async function first() {
  const mine = view;
  try {
    await load();
    if (view !== mine) return false;
    text(mine.none, WORDS.noHistory);
    mine.ageing.refresh();
  } catch (error) {
    if (!(error instanceof mine.ctx.Refused) || error.status !== 404) throw error;
    if (view !== mine) return false;
    for (const one of [...mine.root.children].slice(1)) one.remove();
    mine.root.append(el("p", { class: "bad", role: "alert" }, WORDS.missing(mine.name)));
  }
  return true;
}

export async function open(parent, where, ctx) {
  view = {
    name: where.path[1],
    serial: where.query.get("serial"),
    ctx,
    history: [],
    ticked: new Set(),
    byHand: false,
    turn: 0,
  };
  Object.assign(view, { charts: [], holders: [], shelf: shelf(ctx), calm: calmly(again) });
  build(parent);
  view.watch = new ResizeObserver(() => view.charts.forEach((chart) => chart.fit()));
  view.holders.forEach((holder) => view.watch.observe(holder));
  await ctx.attempt(first);
}

// Events of a run do not name its cells. The history is requested again after each scan of the catalogue.
export function heard(kind, data) {
  if (!view) return;
  const complete = kind === "spectrum" && data.spectrum.corrected;
  if (complete) view.shelf.forget(data.run);
  if (kind === "run") view.shelf.forget(data.item.run);
  if (["catalog", "hello", "lost"].includes(kind)) view.calm.now();
}

export function close() {
  if (!view) return;
  view.calm.end();
  view.watch.disconnect();
  view.charts.forEach((chart) => chart.destroy());
  view.ageing.close();
  view = null;
}
