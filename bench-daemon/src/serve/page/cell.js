// View `#/cell/NAME`: how a cell has aged: its resistances over time, its spectra over age, its runs, and what people
// say about it.
"use strict";

import { el, fill, text, when } from "./bench.js";
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
import { notes } from "./notes.js";
import { comparing } from "./run.js";

const WORDS = {
  title: (name) => `Cell ${name}`,
  looking: "Looking …",
  missing: (name) => `No run has measured a cell ${name}.`,
  serials: (all) => `Serial ${all.length === 1 ? "number" : "numbers"}: ${all.join(", ")}.`,
  noSerial: "No serial number is known.",
  count: (n) => `${n} ${n === 1 ? "spectrum" : "spectra"} measured.`,
  curve: (date, run, repeat) => `${date} ${run}${repeat === null ? "" : `, repeat ${repeat}`}`,
  history: "Resistance over time",
  high: "R high",
  low: "R low",
  highHint: "R high: the real part where the imaginary part changes its sign, else at the highest frequency.",
  lowHint: "R low: the real part at the lowest frequency.",
  lowDiffers: (values) => `The lowest frequency is not the same in all: ${values}. Compare like with like.`,
  highDiffers: "Where R high was read is told in the table.",
  bars: "Bars: ±2σ. ● good, △ doubtful, ✕ failed. The table has the same figures.",
  axis: (name) => `${name} / mΩ`,
  time: "time",
  noCharts: "The part of the page that draws charts is missing; the table has the figures.",
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
  full: (most) => `${most} spectra are ticked, which is the most: untick one to tick another.`,
  shown: (n) => `${n} ${n === 1 ? "spectrum is" : "spectra are"} shown.`,
  lost: (names) => ` Could not be loaded: ${names.join(", ")}.`,
  loading: "The spectra are being loaded …",
  runs: "Runs",
  noRun: "No run yet.",
  runTable: "Runs of this cell",
};

const MOST_CURVES = 12;
// First, latest, and so many between.
const AT_FIRST = 8;
const LATE_MS = 300;
const CHARTS = [
  ["high", "r_high_ohm", "r_high_sigma_ohm", "at_high_hz", "--c0"],
  ["low", "r_low_ohm", "r_low_sigma_ohm", "at_low_hz", "--c1"],
];

let view = null;

const path = (...more) => ["/cells", encodeURIComponent(view.name), ...more].join("/");
const keyOf = (one) => JSON.stringify([one.run, one.spectrum]);
const milli = (ohm) => (Number.isFinite(ohm) ? (1e3 * ohm).toPrecision(4) : WORDS.unknown);
const hertz = (value) => (Number.isFinite(value) ? `${Number(value.toPrecision(3))} Hz` : WORDS.unknown);

// What a measurement of the cell is called: its date first, since this is about age.
const title = (one) => WORDS.curve(when(one.unix_s).slice(0, 16), one.run, one.repeat);

// ---- resistance over time -----------------------------------------------------------------------

const ink = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// Draws one mark; a doubtful or failed measurement differs by its shape.
function mark(ctx, verdictName, x, y, size) {
  ctx.beginPath();
  if (verdictName === "failed") {
    ctx.moveTo(x - size, y - size);
    ctx.lineTo(x + size, y + size);
    ctx.moveTo(x - size, y + size);
    ctx.lineTo(x + size, y - size);
    ctx.stroke();
  } else if (verdictName === "doubtful") {
    ctx.moveTo(x, y - 1.2 * size);
    ctx.lineTo(x + 1.1 * size, y + size);
    ctx.lineTo(x - 1.1 * size, y + size);
    ctx.closePath();
    ctx.stroke();
  } else {
    ctx.arc(x, y, size, 0, 2 * Math.PI);
    ctx.fill();
  }
}

// Marks and bars of ±2σ.
function drawMarks(chart, [, value, sigma, , colour]) {
  const { ctx } = chart;
  const ratio = devicePixelRatio;
  ctx.save();
  ctx.beginPath();
  ctx.rect(chart.bbox.left, chart.bbox.top, chart.bbox.width, chart.bbox.height);
  ctx.clip();
  // The line between them is dashed.
  ctx.setLineDash([]);
  ctx.strokeStyle = ctx.fillStyle = ink(colour);
  ctx.lineWidth = 1.5 * ratio;
  for (const one of view.history) {
    if (!Number.isFinite(one[value])) continue;
    const x = chart.valToPos(one.unix_s, "x", true);
    const at = (ohm) => chart.valToPos(1e3 * ohm, "y", true);
    mark(ctx, one.verdict, x, at(one[value]), 3.5 * ratio);
    if (!Number.isFinite(one[sigma])) continue;
    ctx.beginPath();
    ctx.moveTo(x, at(one[value] - 2 * one[sigma]));
    ctx.lineTo(x, at(one[value] + 2 * one[sigma]));
    ctx.stroke();
  }
  ctx.restore();
}

// All bars within, and some room around.
function range([, value, sigma]) {
  const known = view.history.filter((one) => Number.isFinite(one[value]));
  const ends = known.flatMap((one) => [-2, 2].map((n) => 1e3 * (one[value] + n * (one[sigma] || 0))));
  if (!ends.length) return [0, 1];
  const [low, high] = [Math.min(...ends), Math.max(...ends)];
  const room = (high - low || Math.abs(high) || 1) * 0.08;
  return [low - room, high + room];
}

// A single measurement, or those of one day, still have a stretch of time around them.
function stretch() {
  const times = view.history.map((one) => one.unix_s);
  const [first, last] = [Math.min(...times), Math.max(...times)];
  const room = Math.max(3600, 0.04 * (last - first));
  return [first - room, last + room];
}

const DATES = "{YYYY}-{MM}-{DD}";

function makeChart(holder, spec) {
  const axis = {
    stroke: () => ink("--quiet"),
    grid: { stroke: () => ink("--grid"), width: 1 },
    ticks: { stroke: () => ink("--grid"), width: 1 },
    font: "12px system-ui, sans-serif",
    labelFont: "12px system-ui, sans-serif",
    labelSize: 18,
  };
  const name = WORDS.axis(WORDS[spec[0]]);
  const day = window.uPlot.fmtDate(`${DATES} {HH}:{mm}`);
  const label = (_, value) => (value === null || value === undefined ? WORDS.unknown : value.toPrecision(4));
  const options = {
    width: Math.max(220, holder.clientWidth),
    height: 220,
    cursor: { drag: { x: true, y: false } },
    scales: { x: { range: (_, low, high) => zoomed(low, high) }, y: { range: () => range(spec) } },
    series: [
      { label: WORDS.time, value: (_, at) => (at ? day(new Date(1e3 * at)) : WORDS.unknown) },
      { label: name, stroke: () => ink(spec[4]), width: 1, dash: [2, 4], points: { show: false }, value: label },
    ],
    axes: [
      { ...axis, space: 100, values: dates },
      { ...axis, label: name, size: 58 },
    ],
    hooks: { draw: [(chart) => drawMarks(chart, spec)] },
  };
  return new window.uPlot(options, [[], []], holder);
}

// Drawn over a stretch, the chart shows that; else the whole history.
function zoomed(low, high) {
  const whole = stretch();
  const times = view.history.map((one) => one.unix_s);
  return low <= Math.min(...times) && high >= Math.max(...times) ? whole : [low, high];
}

// Days, and hours below them where the ticks are closer than a day.
function dates(_, ticks, axis, space, step) {
  const day = window.uPlot.fmtDate(DATES);
  const hour = window.uPlot.fmtDate("{MM}-{DD} {HH}:{mm}");
  return ticks.map((at) => (step >= 86400 ? day : hour)(new Date(1e3 * at)));
}

function drawCharts() {
  if (!window.uPlot) return;
  const times = view.history.map((one) => one.unix_s);
  for (const [place, spec] of CHARTS.entries()) {
    const holder = view.holders[place];
    view.charts[place] ||= makeChart(holder, spec);
    const values = view.history.map((one) => (Number.isFinite(one[spec[1]]) ? 1e3 * one[spec[1]] : null));
    view.charts[place].setData([times, values]);
  }
}

function fitCharts() {
  view.charts.forEach((chart, place) => {
    const width = Math.max(220, view.holders[place].clientWidth);
    if (Math.abs(chart.width - width) > 1) chart.setSize({ width, height: chart.height });
  });
}

// What the charts show, in words.
function trend() {
  const words = CHARTS.map(([name, value]) => {
    const known = view.history.filter((one) => Number.isFinite(one[value]));
    if (known.length < 2) return "";
    const [first, last] = [known[0][value], known[known.length - 1][value]];
    const percent = (100 * (last / first - 1)).toFixed(1).replace("-", "−");
    const change = `${last > first ? "+" : ""}${percent} %`;
    return WORDS.trend(WORDS[name], `${milli(first)} mΩ`, `${milli(last)} mΩ`, change);
  });
  return words.join("").trim();
}

// Frequencies that differ by more than a rounding, the lowest first.
function lowest() {
  const all = view.history.map((one) => one.at_low_hz).filter(Number.isFinite);
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
      cell(heads.repeat, one.repeat === null ? WORDS.unknown : String(one.repeat)),
      cell(heads.bench, one.bench),
      cell(heads.verdict, verdict(one.verdict)),
      cell(heads.high, figure(one, CHARTS[0])),
      cell(heads.atHigh, hertz(one.at_high_hz)),
      cell(heads.low, figure(one, CHARTS[1])),
      cell(heads.atLow, hertz(one.at_low_hz)),
    );
  // The latest first: it is what one comes for.
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

// Loads what is ticked, and draws it from the oldest to the latest.
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

function drawRuns(cards) {
  keyed(view.runs, cards, (card) => card.run, (card) => el("tr", {}, ...runCells(card)));
  view.runTable.hidden = !cards.length;
  view.noRun.hidden = cards.length > 0;
}

function take(got) {
  view.history = [...got.history].sort((a, b) => a.unix_s - b.unix_s);
  const there = new Set(view.history.map(keyOf));
  view.ticked = view.byHand ? new Set([...view.ticked].filter((key) => there.has(key))) : preferred();
  const serials = got.serials.length ? WORDS.serials(got.serials) : WORDS.noSerial;
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

async function load() {
  const mine = view;
  const got = await mine.ctx.get(path());
  if (view === mine) take(got);
  return true;
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
  const noCharts = window.uPlot ? null : el("p", { class: "bad" }, WORDS.noCharts);
  view.body = el("div", { hidden: true }, noCharts, pair, view.hints, view.choose, shown);
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
  view.root = begin(
    parent,
    WORDS.title(view.name),
    view.said,
    historySection(),
    view.spectraSection,
    section("fd-runs", WORDS.runs, view.noRun, view.runTable),
    said,
  );
  view.notes = notes(said, path("notes"), view.ctx);
}

// The first time; a cell that nobody measured is told in the page.
async function first() {
  const mine = view;
  try {
    await load();
    if (view === mine) text(mine.none, WORDS.noHistory);
  } catch (error) {
    if (!(error instanceof mine.ctx.Refused) || error.status !== 404) throw error;
    if (view !== mine) return false;
    for (const one of [...mine.root.children].slice(1)) one.remove();
    mine.root.append(el("p", { class: "bad", role: "alert" }, WORDS.missing(mine.name)));
  }
  return true;
}

export async function open(parent, where, ctx) {
  view = { name: where.path[1], ctx, history: [], ticked: new Set(), byHand: false, turn: 0 };
  Object.assign(view, { charts: [], holders: [], shelf: shelf(ctx), calm: calmly(() => load().catch(() => {})) });
  build(parent);
  view.watch = new ResizeObserver(fitCharts);
  view.holders.forEach((holder) => view.watch.observe(holder));
  await ctx.attempt(first);
}

// Which cells a run has is not told with it: the history is asked for again whenever a run has begun or ended, and
// whenever a spectrum is complete.
export function heard(kind, data) {
  if (!view) return;
  const complete = kind === "spectrum" && data.spectrum.corrected;
  if (complete) view.shelf.forget(data.run);
  if (kind === "run") view.shelf.forget(data.item.run);
  if (complete || kind === "run" || kind === "hello" || kind === "lost") view.calm.now();
}

export function close() {
  if (!view) return;
  view.calm.end();
  view.watch.disconnect();
  view.charts.forEach((chart) => chart.destroy());
  view = null;
}
