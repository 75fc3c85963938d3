// A run over time: voltage, current and temperature as strips with one time, their limits, and the
// steps of the run. Drawn by uPlot; numbers are those of the server, thinned without losing a peak.
"use strict";

import { $, duration, el } from "./bench.js";

const uPlot = window.uPlot;
const RECENT_S = 300;
const MOST = 2000;
const HEIGHT = 190;
// Between two readings that lie further apart than this, or 20 times the usual, no line is drawn, s.
const GAP_S = 30;
const STRIPS = [
  ["voltage_v", "Voltage / V", 4, "--c0"],
  ["current_a", "Current / A (charge +)", 3, "--c1"],
  ["temperature_c", "Cell temperature / °C", 2, "--c2"],
  ["charge_mah", "Charge since the beginning / mAh", 2, "--c3"],
];
// Of one ampere-hour, C.
const AH_C = 3600;
const QUANTITIES = { voltage_v: "V", current_a: "A", temperature_c: "°C" };

const shown = { run: "", part: "recent", zoom: null, asked: 0, told: null, charts: [], limits: [] };

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// What is asked for: the last minutes, the whole run, or a stretch that was chosen with the mouse.
function query() {
  if (shown.zoom) return `most=${MOST}&from_s=${shown.zoom[0]}&to_s=${shown.zoom[1]}`;
  if (shown.part === "recent" && shown.told)
    return `most=${MOST}&from_s=${Math.max(0, shown.told.end_s - RECENT_S)}`;
  return `most=${MOST}`;
}

// Lines across a strip: limits of the cell, and where stages and steps begin.
function marks(key) {
  return {
    hooks: {
      draw: [
        (chart) => {
          const { ctx, bbox } = chart;
          ctx.save();
          ctx.beginPath();
          ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
          ctx.clip();
          ctx.lineWidth = devicePixelRatio;
          for (const mark of shown.told.marks) {
            if (mark.kind === "step") continue;
            const x = Math.round(chart.valToPos(mark.time_s, "x", true));
            ctx.strokeStyle = colour(mark.kind === "stage" ? "--quiet" : "--note");
            ctx.setLineDash(mark.kind === "stage" ? [] : [3, 3]);
            ctx.beginPath();
            ctx.moveTo(x, bbox.top);
            ctx.lineTo(x, bbox.top + bbox.height);
            ctx.stroke();
          }
          ctx.setLineDash([8, 4]);
          ctx.strokeStyle = colour("--bad");
          for (const limit of shown.limits.filter((one) => one.unit === QUANTITIES[key]))
            for (const value of [limit.least, limit.greatest]) {
              if (value === null || value === undefined) continue;
              const y = Math.round(chart.valToPos(value, "y", true));
              ctx.beginPath();
              ctx.moveTo(bbox.left, y);
              ctx.lineTo(bbox.left + bbox.width, y);
              ctx.stroke();
            }
          ctx.restore();
        },
      ],
    },
  };
}

function strip(parent, [key, title, digits, ink], choose) {
  const holder = el("div", { class: "strip" });
  parent.append(holder);
  const axis = () => ({
    stroke: () => colour("--quiet"),
    grid: { stroke: () => colour("--grid") },
    ticks: { stroke: () => colour("--grid") },
    font: "12px system-ui, sans-serif",
  });
  const options = {
    width: Math.max(260, holder.clientWidth),
    height: HEIGHT,
    cursor: { sync: { key: "time" }, drag: { x: true, y: false, setScale: false } },
    scales: { x: { time: false } },
    series: [
      { label: "time / s", value: (_, value) => (value === null ? "–" : value.toFixed(1)) },
      {
        label: title,
        stroke: () => colour(ink),
        width: 1.5,
        // So few that a line would hide which there are.
        points: { show: (chart) => chart.data[0].length < 40, size: 5 },
        value: (_, value) => (value === null || value === undefined ? "–" : value.toFixed(digits)),
      },
    ],
    axes: [
      { ...axis(), size: 32 },
      { ...axis(), size: 60 },
    ],
    plugins: [marks(key)],
    hooks: {
      setSelect: [
        (chart) => {
          const { left, width } = chart.select;
          if (width < 4) return;
          choose([chart.posToVal(left, "x"), chart.posToVal(left + width, "x")]);
        },
      ],
    },
  };
  const chart = new uPlot(options, [[], []], holder);
  chart.over.addEventListener("dblclick", () => choose(null));
  shown.charts.push({ key, chart, holder });
}

// The readings of one quantity; where it was not read for long, nothing is drawn.
function line(told, key) {
  const [times, values] = [[], []];
  const usual = (told.time_s[told.time_s.length - 1] - told.time_s[0]) / Math.max(1, told.time_s.length - 1);
  const gap = Math.max(GAP_S, 20 * usual);
  told.time_s.forEach((time, k) => {
    if (told[key][k] === null) return;
    const last = times[times.length - 1];
    if (times.length && time - last > gap) {
      times.push((last + time) / 2);
      values.push(null);
    }
    times.push(time);
    values.push(told[key][k]);
  });
  return [times, values];
}

// What is told beside the strips, for whoever does not see them.
function words(told) {
  const of = (values, digits, unit) => {
    const read = values.filter((value) => value !== null);
    if (!read.length) return "not read";
    const [low, high] = [Math.min(...read), Math.max(...read)];
    return `${low.toFixed(digits)} to ${high.toFixed(digits)} ${unit}`;
  };
  const span = told.time_s.length
    ? `${duration(told.time_s[0])} to ${duration(told.time_s[told.time_s.length - 1])} of bench time`
    : "no reading";
  return (
    `${span}; voltage ${of(told.voltage_v, 4, "V")}; current ${of(told.current_a, 3, "A")}; ` +
    `temperature ${of(told.temperature_c, 2, "°C")}; charge ${of(told.charge_mah, 2, "mAh")}. ` +
    `${told.rows} readings${told.whole ? "" : ", thinned: every peak is kept"}.`
  );
}

// As wide as there is room; needs no server.
export function fitTime() {
  for (const { chart, holder } of shown.charts) {
    const width = Math.max(260, holder.clientWidth);
    if (Math.abs(chart.width - width) > 1) chart.setSize({ width, height: HEIGHT });
  }
}

function draw(choose) {
  const { told } = shown;
  const parent = $("strips");
  if (!shown.charts.length) STRIPS.forEach((one) => strip(parent, one, choose));
  fitTime();
  for (const { key, chart } of shown.charts) {
    // The same stretch of time in all of them.
    chart.setData(line(told, key), false);
    const [first, last] = [told.time_s[0], told.time_s[told.time_s.length - 1]];
    chart.batch(() => {
      chart.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
      chart.setScale("x", { min: first ?? 0, max: last > first ? last : (first ?? 0) + 1 });
    });
  }
  $("timesaid").textContent = words(told);
  $("zoomout").hidden = !shown.zoom;
  const rows = told.marks.filter((mark) => mark.kind !== "step").slice(-50);
  $("timemarks").replaceChildren(
    ...rows.map((mark) => el("li", {}, `${duration(mark.time_s)}: ${mark.kind}, ${mark.text}`)),
  );
}

// Shows a run; `get` asks the server. Called again as often as one likes: what is asked for is the
// latest, and an answer that comes late is dropped.
export async function drawTime(get, run, limits) {
  $("time").hidden = !run;
  if (!run || !uPlot) return;
  if (shown.run !== run) Object.assign(shown, { run, zoom: null, told: null });
  shown.limits = limits;
  const choose = (stretch) => {
    shown.zoom = stretch;
    drawTime(get, run, limits);
  };
  $("zoomout").onclick = () => choose(null);
  for (const name of ["recent", "whole"]) {
    $(name).setAttribute("aria-pressed", String(shown.part === name && !shown.zoom));
    $(name).onclick = () => {
      shown.part = name;
      choose(null);
    };
  }
  const asked = (shown.asked += 1);
  try {
    if (!shown.told) shown.told = await get(`/runs/${run}/readings?most=8`);
    const told = await get(`/runs/${run}/readings?${query()}`);
    if (asked !== shown.asked || shown.run !== run) return;
    told.charge_mah = told.charge_c.map((charge) => (1000 * charge) / AH_C);
    shown.told = told;
    draw(choose);
  } catch {
    // A run that has no reading yet; whoever calls says when the server is lost.
    if (asked === shown.asked && !shown.told) $("timesaid").textContent = "No reading yet.";
  }
}
