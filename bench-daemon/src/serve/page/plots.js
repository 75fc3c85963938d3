// Nyquist and Bode plots as SVG. Curves differ by the shape of their marks, by dashes and by name, not by colour alone.
"use strict";

const NS = "http://www.w3.org/2000/svg";
export const MARKS = ["circle", "square", "triangle", "diamond", "cross", "plus"];

export function mark(kind, x, y, r) {
  const shapes = {
    circle: ["circle", { cx: x, cy: y, r }],
    square: ["rect", { x: x - r, y: y - r, width: 2 * r, height: 2 * r }],
    triangle: ["polygon", { points: `${x},${y - 1.2 * r} ${x - 1.1 * r},${y + r} ${x + 1.1 * r},${y + r}` }],
    diamond: ["polygon", { points: `${x},${y - 1.3 * r} ${x + 1.3 * r},${y} ${x},${y + 1.3 * r} ${x - 1.3 * r},${y}` }],
    cross: ["path", { d: `M${x - r},${y - r}L${x + r},${y + r}M${x - r},${y + r}L${x + r},${y - r}` }],
    plus: ["path", { d: `M${x - r},${y}L${x + r},${y}M${x},${y - r}L${x},${y + r}` }],
  };
  return make(...shapes[kind]);
}

export function make(name, attributes, ...children) {
  const node = document.createElementNS(NS, name);
  for (const [key, value] of Object.entries(attributes || {})) node.setAttribute(key, value);
  node.append(...children);
  return node;
}

// A step of 1, 2 or 5 that gives about `wanted` ticks.
function step(span, wanted) {
  const raw = span / wanted;
  const power = 10 ** Math.floor(Math.log10(raw));
  return power * ([1, 2, 5, 10].find((factor) => factor * power >= raw) || 10);
}

function ticks(least, greatest, wanted) {
  const by = step(greatest - least || 1, wanted);
  const found = [];
  for (let value = Math.ceil(least / by) * by; value <= greatest + 1e-9 * by; value += by)
    found.push(Math.abs(value) < 1e-9 * by ? 0 : value);
  return found;
}

function decades(least, greatest) {
  const found = [];
  for (let power = Math.floor(Math.log10(least)); power <= Math.ceil(Math.log10(greatest)); power += 1)
    found.push(10 ** power);
  const inside = (values) => values.filter((value) => value >= least * 0.999 && value <= greatest * 1.001);
  const whole = inside(found);
  return whole.length > 2 ? whole : inside(found.flatMap((value) => [value, 2 * value, 5 * value]));
}

const short = (value) =>
  (Math.abs(value) >= 1000 ? `${value / 1000}k` : String(Number(value.toPrecision(6)))).replace("-", "−");

// As wide as it is shown, so that letters have their size on a phone too.
function reset(svg) {
  const width = Math.max(280, Math.round(svg.clientWidth || 480));
  const height = Math.round(Math.min(420, Math.max(280, 0.72 * width)));
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  svg.replaceChildren();
  return [width, height];
}

// A frame with axes. `x` and `y`: { range, ticks, title }; returns the group to draw in and the two scales.
function frame(svg, box, x, y) {
  const [left, top, width, height] = box;
  const sx = (value) => left + (width * (x.at(value) - x.at(x.range[0]))) / (x.at(x.range[1]) - x.at(x.range[0]) || 1);
  const sy = (value) =>
    top + height - (height * (y.at(value) - y.at(y.range[0]))) / (y.at(y.range[1]) - y.at(y.range[0]) || 1);
  for (const value of x.ticks) {
    const px = sx(value);
    svg.append(make("line", { class: "grid", x1: px, y1: top, x2: px, y2: top + height }));
    svg.append(make("text", { class: "tick", x: px, y: top + height + 16, "text-anchor": "middle" }, short(value)));
  }
  for (const value of y.ticks) {
    const py = sy(value);
    svg.append(make("line", { class: value === 0 ? "grid zero" : "grid", x1: left, y1: py, x2: left + width, y2: py }));
    svg.append(make("text", { class: "tick", x: left - 6, y: py + 4, "text-anchor": "end" }, short(value)));
  }
  svg.append(make("rect", { class: "frame", x: left, y: top, width, height }));
  if (x.title)
    svg.append(
      make("text", { class: "title", x: left + width / 2, y: top + height + 34, "text-anchor": "middle" }, x.title),
    );
  const ty = top + height / 2;
  svg.append(
    make("text", { class: "title", x: 12, y: ty, "text-anchor": "middle", transform: `rotate(-90 12 ${ty})` }, y.title),
  );
  return [sx, sy];
}

const linear = (value) => value;

// From values to a range with some room around them.
function around(values, least) {
  let [low, high] = [Math.min(...values), Math.max(...values)];
  const room = Math.max((high - low) * 0.08, least);
  return [low - room, high + room];
}

function curve(svg, points, index, errors) {
  const group = make("g", { class: `curve c${index % MARKS.length}` });
  if (points.length > 1)
    group.append(make("polyline", { points: points.map(([x, y]) => `${x.toFixed(1)},${y.toFixed(1)}`).join(" ") }));
  for (const bar of errors || [])
    group.append(make("line", { class: "bar", x1: bar[0], y1: bar[1], x2: bar[2], y2: bar[3] }));
  points.forEach(([x, y, text], place) => {
    const node = mark(MARKS[index % MARKS.length], x, y, place === points.length - 1 ? 5 : 3.5);
    node.classList.add("mark");
    if (text) {
      node.append(make("title", {}, text));
      node.dataset.says = text;
    }
    group.append(node);
  });
  svg.append(group);
}

function empty(svg, width, height, text) {
  svg.append(make("text", { class: "none", x: width / 2, y: height / 2, "text-anchor": "middle" }, text));
}

const say = (p) =>
  `${p.freq_hz.toPrecision(4)} Hz: ${(1e3 * p.re_ohm).toPrecision(4)} ` +
  `${p.im_ohm < 0 ? "−" : "+"} j ${(1e3 * Math.abs(p.im_ohm)).toPrecision(4)} mΩ` +
  (p.re_sigma_ohm === null
    ? ""
    : `, ±σ ${(1e6 * p.re_sigma_ohm).toPrecision(2)} and ${(1e6 * (p.im_sigma_ohm || 0)).toPrecision(2)} µΩ`);

// Tells the point nearest to the pointer in a line of its own, which stays when the plot is drawn anew.
export function tellPoints(svg, line) {
  svg.addEventListener("pointermove", (event) => {
    let [best, least] = [null, 40];
    for (const node of svg.querySelectorAll(".mark")) {
      const box = node.getBoundingClientRect();
      const [dx, dy] = [event.clientX - (box.left + box.right) / 2, event.clientY - (box.top + box.bottom) / 2];
      const far = Math.hypot(dx, dy);
      if (node.dataset.says && far < least) [best, least] = [node, far];
    }
    if (best) line.textContent = best.dataset.says;
  });
}

// −Im over Re in mΩ, the same scale on both axes.
export function nyquist(svg, curves) {
  const [width, height] = reset(svg);
  const all = curves.flatMap((one) => one.points);
  if (!all.length) return empty(svg, width, height, "no point yet");
  const box = [58, 14, width - 72, height - 64];
  let xr = around(
    all.map((p) => 1e3 * p.re_ohm),
    0.05,
  );
  let yr = around([...all.map((p) => -1e3 * p.im_ohm), 0], 0.05);
  const scale = Math.max((xr[1] - xr[0]) / box[2], (yr[1] - yr[0]) / box[3]);
  const widen = (range, pixels) => {
    const more = (scale * pixels - (range[1] - range[0])) / 2;
    return [range[0] - more, range[1] + more];
  };
  xr = widen(xr, box[2]);
  yr = widen(yr, box[3]);
  const x = { range: xr, at: linear, ticks: ticks(...xr, 6), title: "Re Z / mΩ" };
  const y = { range: yr, at: linear, ticks: ticks(...yr, 5), title: "−Im Z / mΩ" };
  const [sx, sy] = frame(svg, box, x, y);
  curves.forEach((one, index) => {
    const bars = one.points
      .filter((p) => p.re_sigma_ohm !== null)
      .flatMap((p) => {
        const [cx, cy] = [sx(1e3 * p.re_ohm), sy(-1e3 * p.im_ohm)];
        const [dx, dy] = [(2e3 * p.re_sigma_ohm) / scale, (2e3 * (p.im_sigma_ohm || 0)) / scale];
        return [
          [cx - dx, cy, cx + dx, cy],
          [cx, cy - dy, cx, cy + dy],
        ];
      });
    curve(
      svg,
      one.points.map((p) => [sx(1e3 * p.re_ohm), sy(-1e3 * p.im_ohm), say(p)]),
      one.index ?? index,
      bars,
    );
  });
}

// Standard uncertainty of |Z|, Ω, and of the phase, rad.
const sigmaAbs = (p) =>
  Math.hypot(p.re_ohm * p.re_sigma_ohm, p.im_ohm * (p.im_sigma_ohm || 0)) / Math.hypot(p.re_ohm, p.im_ohm);
const sigmaAngle = (p) =>
  Math.hypot(p.im_ohm * p.re_sigma_ohm, p.re_ohm * (p.im_sigma_ohm || 0)) / Math.hypot(p.re_ohm, p.im_ohm) ** 2;

// |Z| and phase over frequency.
export function bode(svg, curves) {
  const [width, height] = reset(svg);
  const all = curves.flatMap((one) => one.points);
  if (!all.length) return empty(svg, width, height, "no point yet");
  const freqs = all.map((p) => p.freq_hz);
  const xr = [Math.min(...freqs) / 1.3, Math.max(...freqs) * 1.3];
  const x = { range: xr, at: Math.log10, ticks: decades(...xr) };
  const abs = (p) => 1e3 * Math.hypot(p.re_ohm, p.im_ohm);
  const angle = (p) => (180 / Math.PI) * Math.atan2(p.im_ohm, p.re_ohm);
  const half = (height - 84) / 2;
  const upper = around(all.map(abs), 0.05);
  const lower = around(all.map(angle), 1);
  const [ux, uy] = frame(
    svg,
    [58, 14, width - 72, half],
    { ...x },
    { range: upper, at: linear, ticks: ticks(...upper, 4), title: "|Z| / mΩ" },
  );
  const [lx, ly] = frame(
    svg,
    [58, 40 + half, width - 72, half - 8],
    { ...x, title: "frequency / Hz" },
    { range: lower, at: linear, ticks: ticks(...lower, 4), title: "phase / °" },
  );
  curves.forEach((one, index) => {
    const known = one.points.filter((p) => p.re_sigma_ohm !== null);
    // Bars of ±2σ, the errors of both parts taken as independent.
    const bars = (x, y, of, sigma) =>
      known.map((p) => [x(p.freq_hz), y(of(p) - 2 * sigma(p)), x(p.freq_hz), y(of(p) + 2 * sigma(p))]);
    curve(
      svg,
      one.points.map((p) => [ux(p.freq_hz), uy(abs(p)), say(p)]),
      one.index ?? index,
      bars(ux, uy, abs, (p) => 1e3 * sigmaAbs(p)),
    );
    curve(
      svg,
      one.points.map((p) => [lx(p.freq_hz), ly(angle(p)), say(p)]),
      one.index ?? index,
      bars(lx, ly, angle, (p) => (180 / Math.PI) * sigmaAngle(p)),
    );
  });
}
