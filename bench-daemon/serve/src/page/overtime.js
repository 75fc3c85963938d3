// A quantity of a cell over calendar time, as a chart with marks and bars. A table beside the chart contains the same
// data; the chart is hidden from screen readers.
"use strict";

import { axis, decimals, ink, minus } from "./bench.js";

const WORDS = {
  unknown: "–",
  time: "time",
  noCharts: "The part of the page that draws charts is missing; the table has the figures.",
};

const DATES = "{YYYY}-{MM}-{DD}";
const HEIGHT = 220;
const LEAST_WIDTH = 220;
// So far off, px, a mark may be pressed; a press that moves farther draws over a stretch.
const REACH = 16;
const STILL = 4;


// Message if charts cannot be drawn, otherwise null.
export const noCharts = () => (window.uPlot ? null : WORDS.noCharts);

// Returns a value and the ends of its error bar, multiplied by `times`; without an uncertainty it has no bar.
export function bar({ value, sigma }, times) {
  const half = Number.isFinite(sigma) ? sigma : NaN;
  return { value: times * value, low: times * (value - half), high: times * (value + half) };
}

// Marks by the kind of value; they differ by their shape.
const MARKS = {
  failed(ctx, x, y, size) {
    ctx.moveTo(x - size, y - size);
    ctx.lineTo(x + size, y + size);
    ctx.moveTo(x - size, y + size);
    ctx.lineTo(x + size, y - size);
    ctx.stroke();
  },
  doubtful(ctx, x, y, size) {
    ctx.moveTo(x, y - 1.2 * size);
    ctx.lineTo(x + 1.1 * size, y + size);
    ctx.lineTo(x - 1.1 * size, y + size);
    ctx.closePath();
    ctx.stroke();
  },
  other(ctx, x, y, size) {
    ctx.moveTo(x, y - 1.3 * size);
    ctx.lineTo(x + 1.3 * size, y);
    ctx.lineTo(x, y + 1.3 * size);
    ctx.lineTo(x - 1.3 * size, y);
    ctx.closePath();
    ctx.stroke();
  },
  good(ctx, x, y, size) {
    ctx.arc(x, y, size, 0, 2 * Math.PI);
    ctx.fill();
  },
};

// Creates a chart within `holder`; `look` has the `name` of the quantity, the `axis` and the `colour`. `show(points)`
// draws points in the order of time, each with `unix_s`, `value`, `low` and `high` of its bar, its `mark`, whether it
// is `joined` to others, and an optional `href` that a press on it opens.
export function overTime(holder, look) {
  const state = { points: [] };
  const chart = makeChart(holder, look, state);
  chart.over.addEventListener("mousedown", (event) => (state.pressed = event.clientX));
  chart.over.addEventListener("click", (event) => {
    const near = Math.abs(event.clientX - state.pressed) < STILL && nearest(chart, state.points, event);
    if (near && near.href) location.hash = near.href;
  });
  return {
    show(points) {
      state.points = points;
      chart.setData([points.map((one) => one.unix_s), points.map((one) => one.value)]);
    },
    fit() {
      const width = Math.max(LEAST_WIDTH, holder.clientWidth);
      if (Math.abs(chart.width - width) > 1) chart.setSize({ width, height: HEIGHT });
    },
    destroy: () => chart.destroy(),
  };
}

function nearest(chart, points, event) {
  const box = chart.over.getBoundingClientRect();
  const away = (one) =>
    Math.hypot(
      chart.valToPos(one.unix_s, "x") - (event.clientX - box.left),
      chart.valToPos(one.value, "y") - (event.clientY - box.top),
    );
  const sorted = points.filter((one) => away(one) < REACH).sort((a, b) => away(a) - away(b));
  return sorted[0] || null;
}

function makeChart(holder, look, state) {
  const day = window.uPlot.fmtDate(`${DATES} {HH}:{mm}`);
  const label = (_, value) => (value === null || value === undefined ? WORDS.unknown : value.toPrecision(4));
  const x = { range: (_, low, high) => zoomed(state.points, low, high) };
  const options = {
    width: Math.max(LEAST_WIDTH, holder.clientWidth),
    height: HEIGHT,
    cursor: { drag: { x: true, y: false } },
    scales: { x, y: { range: () => range(state.points) } },
    series: [
      { label: WORDS.time, value: (_, at) => (at ? day(new Date(1e3 * at)) : WORDS.unknown) },
      { label: look.name, paths: () => null, points: { show: false }, value: label },
    ],
    axes: [
      axis({ space: 100, values: dates }),
      axis({ label: look.axis, size: 70, values: figures }),
    ],
    hooks: { draw: [(chart) => drawMarks(chart, state.points, look.colour)] },
  };
  return new window.uPlot(options, [[], []], holder);
}

// Marks, bars, and a dashed line through the marks that compare.
function drawMarks(chart, points, colour) {
  const { ctx } = chart;
  const ratio = devicePixelRatio;
  const x = (one) => chart.valToPos(one.unix_s, "x", true);
  const y = (value) => chart.valToPos(value, "y", true);
  ctx.save();
  ctx.beginPath();
  ctx.rect(chart.bbox.left, chart.bbox.top, chart.bbox.width, chart.bbox.height);
  ctx.clip();
  ctx.strokeStyle = ctx.fillStyle = ink(colour);
  ctx.lineWidth = ratio;
  ctx.setLineDash([2 * ratio, 4 * ratio]);
  ctx.beginPath();
  for (const one of points.filter((point) => point.joined)) ctx.lineTo(x(one), y(one.value));
  ctx.stroke();
  ctx.setLineDash([]);
  ctx.lineWidth = 1.5 * ratio;
  for (const one of points) {
    ctx.beginPath();
    (MARKS[one.mark] || MARKS.good)(ctx, x(one), y(one.value), 3.5 * ratio);
    if (!Number.isFinite(one.low)) continue;
    ctx.beginPath();
    ctx.moveTo(x(one), y(one.low));
    ctx.lineTo(x(one), y(one.high));
    ctx.stroke();
  }
  ctx.restore();
}

// All bars within, and some room around.
function range(points) {
  const ends = points.flatMap((one) => [one.low, one.high, one.value]).filter(Number.isFinite);
  if (!ends.length) return [0, 1];
  const low = ends.reduce((least, end) => Math.min(least, end));
  const high = ends.reduce((greatest, end) => Math.max(greatest, end));
  const room = (high - low || Math.abs(high) || 1) * 0.08;
  return [low - room, high + room];
}

// Adds time around a single measurement, or around those of one day.
function stretch(points) {
  const [first, last] = [points[0].unix_s, points[points.length - 1].unix_s];
  const room = Math.max(3600, 0.04 * (last - first));
  return [first - room, last + room];
}

// Dragging over an interval zooms to it; otherwise the whole history is shown.
function zoomed(points, low, high) {
  if (!points.length) return [0, 1];
  return low <= points[0].unix_s && high >= points[points.length - 1].unix_s ? stretch(points) : [low, high];
}

// Uses as many digits as distinguish adjacent ticks.
const figures = (_, ticks, axis, space, step) => ticks.map((value) => minus(value.toFixed(decimals(step))));

// Formats dates, and hours below them if ticks are closer than a day.
function dates(_, ticks, axis, space, step) {
  const day = window.uPlot.fmtDate(DATES);
  const hour = window.uPlot.fmtDate("{MM}-{DD} {HH}:{mm}");
  return ticks.map((at) => (step >= 86400 ? day : hour)(new Date(1e3 * at)));
}
