// Spectra as interactive plots: Nyquist, Bode, residuals of a model and the difference of two curves. A classic script
// that requires only window.d3, so that the page and a report in one file use identical code. Curves differ by the
// shape of their marks, by dashes and by name, not by colour alone.
(() => {
  "use strict";

  const { d3 } = window;

  // All visible text. Names in braces are replaced by values.
  const WORDS = {
    tools: "Tools of the plots",
    zoomIn: "Zoom in",
    zoomOut: "Zoom out",
    whole: "Whole",
    zoomHint: "Ctrl and wheel over a plot zooms; after a click into the plots the wheel alone does",
    zoomed: "Zoom {times}",
    model: "Model",
    compare: "Compare",
    compareWith: "Compare with",
    compareFile: "Compare with a file …",
    fileHint: "A file of a spectrum, such as .csv, .DTA, .mpt, .mpr, .z, .ism or .xlsx; it can be dropped here too",
    files: "Files that are compared",
    takeOut: "Take out {file}",
    fileOf: "{file}: {name}",
    reading: "{file} is being read …",
    fileRead: "{file}: {count} spectra; {name} is shown and compared, the others are in the list.",
    fileReadOne: "{file}: its spectrum is shown and compared.",
    fileFailed: "{file} cannot be compared: {why}",
    none: "none",
    logMagnitude: "|Z| logarithmic",
    logFrequency: "Frequency logarithmic",
    paper: "White ground",
    save: "Save {kind}",
    saved: "{file} is saved",
    notSaved: "Not saved: {why}",
    legend: "Curves, to show or to hide",
    points: "points",
    onePoint: "point",
    asRead: "as read",
    bars: "bars: ±2σ",
    doubtedMark: "hollow with a cross: not accepted",
    modelLine: "dashed: {model}",
    area: "Plots of the spectra",
    hint:
      "Point at a curve to read the nearest point. Drag, pinch, or Ctrl and wheel move and zoom. Keys: left and " +
      "right go along a curve, up and down to another one, +, − and 0 zoom.",
    nothing: "No point selected.",
    hintEnter: "A click or Enter chooses the point.",
    nyquist: "Nyquist plot: minus imaginary part over real part, the same scale on both axes",
    bode: "Bode plot: magnitude and phase over frequency",
    residuals: "Residuals of the model over frequency, in standard deviations",
    difference: "Difference of two curves over frequency",
    nyquistCaption: "Nyquist",
    bodeCaption: "Bode",
    residualsCaption: "Residuals of {model}:  ● Re  □ Im",
    differenceCaption: "Difference:  ● Re  □ Im",
    re: "Re Z / mΩ",
    im: "−Im Z / mΩ",
    magnitude: "|Z| / mΩ",
    phase: "phase / °",
    frequency: "frequency / Hz",
    sigmas: "residual / σ",
    delta: "Δ / {unit}",
    empty: "no point yet",
    point: "{curve}: {freq}; Re {re}; Im {im}; |Z| {magnitude}; phase {phase}°; {verdict}",
    value: "{value} {unit}, σ not known",
    valueSigma: "{value} ± {sigma} {unit}",
    accepted: "accepted",
    doubted: "not accepted: {why}",
    compared:
      "{first} − {second}: {low} to {high}, {count} points ({between} of them interpolated over log frequency). " +
      "Largest difference: {size} at {freq} (Re {re}, Im {im}). {judged}",
    beyond: "Beyond 2σ in Re or Im: {beyond} of {known}.",
    unjudged: "σ is not known in both: not judged.",
    nothingCommon: "{first} and {second} have no frequency range in common.",
    nothingAccepted: "{first} − {second}: no point that was accepted in both.",
    table: "The points as a table",
    tableCaption: "Points of the curves that are shown",
    head: ["Curve", "f / Hz", "Re Z / mΩ", "Im Z / mΩ", "σ Re / µΩ", "σ Im / µΩ", "Verdict"],
    unknown: "–",
    file: "spectra",
  };

  const LOOKS = 6;
  // How far off, px, a point may be pointed at; how deep one may zoom; and by how much with one press.
  const REACH = 40;
  const DEEPEST = 500;
  // Sources of a curve: a control, or a file that a user has added.
  const [CONTROL, FILE] = ["control", "file"];
  const STEP = 1.5;
  const MARGIN = { left: 62, right: 12, top: 24, bottom: 42 };

  // Corners of the marks, half a width being 1; the circle has none.
  const corners = (text) => text.split(" ").map((corner) => corner.split(",").map(Number));
  const ARM = corners("-.38,-1.25 .38,-1.25 .38,-.38");
  const PLUS = [
    ...ARM,
    ...ARM.map(([x, y]) => [-y, x]),
    ...ARM.map(([x, y]) => [-x, -y]),
    ...ARM.map(([x, y]) => [y, -x]),
  ];
  const CORNERS = [
    null,
    corners("-1,-1 1,-1 1,1 -1,1"),
    corners("0,-1.2 -1.1,1 1.1,1"),
    corners("0,-1.35 1.35,0 0,1.35 -1.35,0"),
    PLUS.map(([x, y]) => [(x - y) * Math.SQRT1_2, (x + y) * Math.SQRT1_2]),
    PLUS,
  ];

  // ---- small things -----------------------------------------------------------------------------

  const put = (template, values) => template.replace(/\{(\w+)\}/g, (_, key) => values[key]);
  const px = (value) => Math.round(10 * value) / 10;
  const minus = (text) => text.replaceAll("-", "−");
  const short = (value) =>
    minus(Math.abs(value) >= 1000 ? `${Number((value / 1000).toPrecision(8))}k` : `${Number(value.toPrecision(8))}`);
  const digits = (value, count) => minus(value.toPrecision(count));
  const say = (node, text) => node.textContent !== text && (node.textContent = text);
  const magnitude = (p) => Math.hypot(p.re_ohm, p.im_ohm);
  const angle = (p) => (180 / Math.PI) * Math.atan2(p.im_ohm, p.re_ohm);
  const known = (p) => Number.isFinite(p.re_sigma_ohm) && Number.isFinite(p.im_sigma_ohm);
  // Standard uncertainty of |Z|, Ω, and of the phase, °; the errors of both parts are assumed to be independent.
  const magnitudeSigma = (p) => Math.hypot(p.re_ohm * p.re_sigma_ohm, p.im_ohm * p.im_sigma_ohm) / magnitude(p);
  const angleSigma = (p) =>
    ((180 / Math.PI) * Math.hypot(p.im_ohm * p.re_sigma_ohm, p.re_ohm * p.im_sigma_ohm)) / magnitude(p) ** 2;

  function fill(node, attributes, children) {
    for (const [key, value] of Object.entries(attributes || {}))
      if (key.startsWith("on")) node.addEventListener(key.slice(2), value);
      else if (value !== null) node.setAttribute(key, value);
    node.append(...children);
    return node;
  }
  const el = (name, attributes, ...children) => fill(document.createElement(name), attributes, children);
  const svg = (name, attributes, ...children) =>
    fill(document.createElementNS("http://www.w3.org/2000/svg", name), attributes, children);

  function frequency(hertz) {
    const unit = hertz >= 1e6 ? "MHz" : hertz >= 1e3 ? "kHz" : hertz >= 1 ? "Hz" : "mHz";
    return `${Number((hertz / { MHz: 1e6, kHz: 1e3, Hz: 1, mHz: 1e-3 }[unit]).toPrecision(4))} ${unit}`;
  }

  const SIZES = { Ω: 1, mΩ: 1e-3, µΩ: 1e-6 };
  const unitOf = (ohm) => (Math.abs(ohm) >= 1 ? "Ω" : Math.abs(ohm) >= 1e-4 ? "mΩ" : "µΩ");

  // Formats a value and its σ with as many digits as σ permits, in a unit that suits the whole impedance.
  function measured(s, ohm, sigma, unit) {
    const [value, error] = [ohm / SIZES[unit], sigma / SIZES[unit]];
    const size = error > 0 ? error / 10 : Math.abs(value) / 1e4;
    const places = size > 0 ? Math.max(0, Math.min(9, -Math.floor(Math.log10(size)))) : 0;
    const values = { value: minus(value.toFixed(places)), sigma: error.toFixed(places), unit };
    return put(Number.isFinite(sigma) ? s.words.valueSigma : s.words.value, values);
  }

  const doubted = (p) => typeof p.verdict === "string";
  const verdict = (s, p) => (doubted(p) ? put(s.words.doubted, { why: p.verdict }) : s.words.accepted);

  // From values to a range with some room around them.
  function around(values, least, log) {
    const [low, high] = d3.extent(log ? values.filter((value) => value > 0) : values);
    if (log) return [(low || least) / 1.15, (high || least) * 1.15];
    const room = Math.max((high - low) * 0.08, least);
    return [low - room, high + room];
  }

  // All marks share one drawing, so that each adds only its two coordinates.
  const stamps = new Map();
  function shape(kind, x, y, r) {
    const key = 100 * kind + r;
    if (!stamps.has(key)) stamps.set(key, stamp(CORNERS[kind], r));
    return `M${px(x)},${px(y)}${stamps.get(key)}`;
  }

  function stamp(outline, r) {
    if (!outline) return `m${-r},0a${r},${r} 0 1,0 ${2 * r},0a${r},${r} 0 1,0 ${-2 * r},0z`;
    const from = (k) => (k ? outline[k - 1] : [0, 0]);
    const steps = outline.map(([x, y], k) => `${px(r * (x - from(k)[0]))},${px(r * (y - from(k)[1]))}`);
    return `m${steps[0]}l${steps.slice(1).join("l")}z`;
  }

  // ---- data to show -----------------------------------------------------------------------------

  const usable = (p) => p.freq_hz > 0 && Number.isFinite(p.re_ohm) && Number.isFinite(p.im_ohm);

  // After six curves the colours come again, with other marks.
  function own(given, place, source) {
    const index = given.index ?? place;
    const look = { colour: index % LOOKS, mark: (index + Math.floor(index / LOOKS)) % LOOKS };
    return { id: given.id, name: given.name, given, source, ...look, points: given.points.filter(usable) };
  }

  // Controls are curves too, but lie far from those of a cell: they are hidden until the user selects them. So are all
  // curves of a file except the first, because a file may contain many.
  function take(s, given) {
    const { curves, models, controls } = given;
    const before = new Set(s.curves.map((one) => one.id));
    const shown = [...curves.map((one, k) => own(one, k)), ...(controls || []).map((one, k) => own(one, k, CONTROL))];
    const brought = s.files.flatMap((file) => file.curves);
    s.given = given;
    s.curves = [...shown, ...brought.map((one, k) => own(one, curves.length + k, FILE))];
    s.models = models || [];
    for (const one of s.curves) if (one.source && !s.seen.has(one.id)) s.hidden.add(one.id);
    s.curves.forEach((one) => s.seen.add(one.id));
    // The zoom does not apply to other curves.
    if (!shown.some((one) => before.has(one.id))) s.views = { near: null, band: null };
  }

  const curveOf = (s, id) => s.curves.find((one) => one.id === id);
  const placeOf = (one, hertz) => one.points.findIndex((p) => Math.abs(p.freq_hz / hertz - 1) < 1e-6);

  // Derives, once for each drawing, all values that follow from the data and the selection.
  function settle(s) {
    s.shown = s.curves.filter((one) => !s.hidden.has(one.id));
    const offered = s.models.filter((one) => s.shown.some((curve) => curve.id === one.curve));
    s.names = [...new Set(offered.map((one) => one.name))];
    // The recommended model is shown first, or else the highest order.
    const rank = (one) => (one.recommended ? Infinity : one.order);
    const preferred = offered.reduce((best, one) => (best && rank(best) >= rank(one) ? best : one), null);
    s.model = s.wanted === "" || s.names.includes(s.wanted) ? s.wanted : preferred ? preferred.name : "";
    s.fitted = offered.filter((one) => one.name === s.model);
    const second = curveOf(s, s.against);
    const first = curveOf(s, s.base) || s.shown.find((one) => one !== second);
    s.pair = first && second && first !== second ? difference(first, second) : null;
    s.first = first || null;
    const active = s.active && s.shown.find((one) => one.id === s.active.id);
    // Points may have come before it: it is found again by its frequency.
    if (!active) s.active = null;
    else if ((active.points[s.active.place] || {}).freq_hz !== s.active.freq_hz) {
      const place = placeOf(active, s.active.freq_hz);
      s.active = place < 0 ? null : { ...s.active, place };
    }
    if (!s.busy) s.bounds = bounds(s);
  }

  const along = (s, hertz) => (s.log.frequency ? Math.log10(hertz) : hertz);

  // Full extent of each kind of axes: the middle, and the ranges from which the span follows.
  function bounds(s) {
    const all = s.shown.flatMap((one) => one.points);
    if (!all.length) return null;
    const range = (of, least, ...more) => around([...more, ...all.map(of)], least);
    const re = range((p) => 1e3 * p.re_ohm, 1e-3);
    const im = range((p) => -1e3 * p.im_ohm, 1e-3, 0);
    const u = range((p) => along(s, p.freq_hz), 0.1);
    return { near: { x: re, y: im }, band: { x: u, y: [0, 0] } };
  }

  // Differences at the frequencies of the first curve, the second interpolated over log frequency.
  function difference(first, second) {
    const sorted = [...second.points].sort((a, b) => a.freq_hz - b.freq_hz);
    const rows = [];
    first.points.forEach((p, place) => {
      const after = sorted.findIndex((q) => q.freq_hz >= p.freq_hz * (1 - 1e-6));
      if (after < 0) return;
      const [low, high] = [sorted[after - 1], sorted[after]];
      const same = Math.abs(high.freq_hz / p.freq_hz - 1) < 1e-6;
      if (!same && !low) return;
      const t = same ? 1 : Math.log(p.freq_hz / low.freq_hz) / Math.log(high.freq_hz / low.freq_hz);
      const mean = (key) => (same ? high[key] : (1 - t) * low[key] + t * high[key]);
      const sigma = (key) => {
        const parts = same ? [p[key], high[key]] : [p[key], low[key], high[key]];
        if (!parts.every(Number.isFinite)) return null;
        return same ? Math.hypot(p[key], high[key]) : Math.hypot(p[key], (1 - t) * low[key], t * high[key]);
      };
      rows.push({
        place,
        freq_hz: p.freq_hz,
        between: !same,
        re_ohm: p.re_ohm - mean("re_ohm"),
        im_ohm: p.im_ohm - mean("im_ohm"),
        re_sigma_ohm: sigma("re_sigma_ohm"),
        im_sigma_ohm: sigma("im_sigma_ohm"),
        verdict: ([p, high, ...(same ? [] : [low])].find(doubted) || p).verdict,
      });
    });
    return { first, second, rows };
  }

  function comparison(s) {
    if (!s.pair) return "";
    const names = { first: s.pair.first.name, second: s.pair.second.name };
    if (!s.pair.rows.length) return put(s.words.nothingCommon, names);
    const rows = s.pair.rows.filter((row) => !doubted(row));
    if (!rows.length) return put(s.words.nothingAccepted, names);
    const [low, high] = d3.extent(rows, (row) => row.freq_hz);
    const most = rows[d3.maxIndex(rows, magnitude)];
    const unit = unitOf(magnitude(most) / 10);
    const places = Math.max(0, 2 - Math.floor(Math.log10(magnitude(most) / SIZES[unit] || 1)));
    // Rounded twice, so that −0 is never shown.
    const ohms = (value) => `${minus(Number((value / SIZES[unit]).toFixed(places)).toFixed(places))} ${unit}`;
    const far = (row, part) => Math.abs(row[`${part}_ohm`]) > 2 * row[`${part}_sigma_ohm`];
    const judged = rows.filter(known);
    const beyond = judged.filter((row) => far(row, "re") || far(row, "im")).length;
    return put(s.words.compared, {
      ...names,
      low: frequency(low),
      high: frequency(high),
      count: rows.length,
      between: rows.filter((row) => row.between).length,
      size: ohms(magnitude(most)),
      freq: frequency(most.freq_hz),
      re: ohms(most.re_ohm),
      im: ohms(most.im_ohm),
      judged: judged.length ? put(s.words.beyond, { beyond, known: judged.length }) : s.words.unjudged,
    });
  }

  // ---- axes and zoom ----------------------------------------------------------------------------

  // A view is its middle and its span over the width of the box, in units of the axes. Nyquist has one scale for
  // both axes, so that equal axes follow from how a view is written down.
  function whole(s, plot) {
    const { x, y } = s.bounds[plot.view];
    const { width, height } = plot.box;
    const span = Math.max(x[1] - x[0], ((y[1] - y[0]) * width) / height);
    return { x: (x[0] + x[1]) / 2, y: (y[0] + y[1]) / 2, span };
  }

  // Restricts a view to the full extent; null is the full extent itself.
  function within(view, plot) {
    const { base, box } = plot;
    if (!view || view.span > 0.999 * base.span) return null;
    const span = Math.max(view.span, base.span / DEEPEST);
    const slack = (base.span - span) / 2;
    const keep = (value, middle, room) => Math.max(middle - room, Math.min(middle + room, value));
    return { span, x: keep(view.x, base.x, slack), y: keep(view.y, base.y, (slack * box.height) / box.width) };
  }

  const middle = ({ left, top, width, height }) => [left + width / 2, top + height / 2];

  function toTransform(plot, view) {
    const { base, box } = plot;
    const [cx, cy] = middle(box);
    const [k, scale] = [base.span / view.span, box.width / base.span];
    const at = [cx + (view.x - base.x) * scale, cy - (view.y - base.y) * scale];
    return d3.zoomIdentity.translate(cx - k * at[0], cy - k * at[1]).scale(k);
  }

  function fromTransform(plot, transform) {
    const { base, box } = plot;
    const [cx, cy] = middle(box);
    const [x, y] = transform.invert([cx, cy]);
    const scale = base.span / box.width;
    return { x: base.x + (x - cx) * scale, y: base.y - (y - cy) * scale, span: base.span / transform.k };
  }

  // Returns the present view of a plot, after the pointer's state was synchronised with it.
  function viewOf(s, plot) {
    plot.base = whole(s, plot);
    s.views[plot.view] = within(s.views[plot.view], plot);
    const { left, top, width, height } = plot.box;
    const corners = [
      [left, top],
      [left + width, top + height],
    ];
    plot.zoom.extent(corners).translateExtent(corners);
    const view = s.views[plot.view] || plot.base;
    if (s.busy !== plot) d3.select(plot.hit).call(plot.zoom.transform, toTransform(plot, view));
    plot.hit.classList.toggle("cv-near", Boolean(s.views[plot.view]));
    return view;
  }

  function zoomable(s, plot) {
    const wheel = (event) => event.ctrlKey || s.area === document.activeElement;
    // One finger scrolls the page while the plot is not zoomed.
    const touch = (event) => event.touches.length > 1 || Boolean(s.views[plot.view]);
    plot.zoom = d3
      .zoom()
      .scaleExtent([1, DEEPEST])
      .filter((event) =>
        event.type === "wheel" ? wheel(event) : event.touches ? touch(event) : !event.button && !event.ctrlKey,
      )
      // An event without a source comes from `viewOf`, not from the user.
      .on("start", (event) => event.sourceEvent && (s.busy = plot))
      .on("zoom", (event) => {
        if (!event.sourceEvent) return;
        s.views[plot.view] = fromTransform(plot, event.transform);
        later(s);
      })
      .on("end", (event) => {
        if (!event.sourceEvent) return;
        s.busy = null;
        draw(s);
      });
    d3.select(plot.hit).call(plot.zoom).on("dblclick.zoom", null);
  }

  function later(s) {
    if (!s.waiting) s.waiting = requestAnimationFrame(() => draw(s));
  }

  // Position of a point on the axes of a plot.
  const spotOf = (s, plot, p) =>
    plot.view === "near" ? { x: 1e3 * p.re_ohm, y: -1e3 * p.im_ohm } : { x: along(s, p.freq_hz), y: 0 };

  function inView(plot, view, at) {
    const half = view.span / 2;
    const tall = plot.view === "near" ? (half * plot.box.height) / plot.box.width : Infinity;
    return Math.abs(at.x - view.x) <= half && Math.abs(at.y - view.y) <= tall;
  }

  // Buttons and keys zoom both kinds of axes around the selected point, if it is visible.
  function zoomBy(s, factor) {
    if (!s.bounds) return;
    for (const plot of [s.plots.nyquist, s.plots.bode]) {
      const view = s.views[plot.view] || plot.base;
      const at = s.active && spotOf(s, plot, activePoint(s));
      const around = at && inView(plot, view, at) ? at : view;
      const ratio = Math.max(1 / factor, plot.base.span / DEEPEST / view.span);
      const to = (key) => around[key] + (view[key] - around[key]) * ratio;
      s.views[plot.view] = { x: to("x"), y: to("y"), span: view.span * ratio };
    }
    draw(s);
    const { base } = s.plots.nyquist;
    say(s.said, put(s.words.zoomed, { times: (base.span / (s.views.near || base).span).toFixed(1) }));
  }

  function zoomOff(s) {
    s.views = { near: null, band: null };
    draw(s);
    say(s.said, s.words.whole);
  }

  // Scrolls to the selected point during keyboard navigation.
  function reveal(s) {
    for (const plot of [s.plots.nyquist, s.plots.bode]) {
      const view = s.views[plot.view];
      const at = spotOf(s, plot, activePoint(s));
      if (!view || inView(plot, view, at)) continue;
      s.views[plot.view] = { ...view, ...at };
      later(s);
    }
  }

  function ticks(scale, wanted) {
    const [low, high] = scale.domain();
    if (!scale.base) return scale.ticks(wanted);
    const powers = d3.range(Math.floor(Math.log10(low)), Math.ceil(Math.log10(high)) + 1).map((power) => 10 ** power);
    const inside = (values) => values.filter((value) => value >= low && value <= high);
    const decades = inside(powers);
    const every = Math.ceil(decades.length / (wanted + 1));
    if (decades.length > 2) return decades.filter((_, k) => k % every === 0);
    const finer = inside(powers.flatMap((value) => [value, 2 * value, 5 * value]));
    return finer.length > 1 ? finer : d3.ticks(low, high, wanted);
  }

  // A frame with axes; returns the group to draw in, which is cut off at the frame.
  function frame(s, plot, { left, top, width, height }, x, y, titles) {
    const { scene } = plot;
    const clip = `cv-clip-${s.number}-${plot.key}-${scene.childElementCount}`;
    const [right, bottom] = [left + width, top + height];
    const text = (name, at, words, more) => svg("text", { class: name, x: px(at[0]), y: px(at[1]), ...more }, words);
    for (const value of ticks(x, Math.max(3, Math.floor(width / 70)))) {
      const at = px(x(value));
      scene.append(svg("line", { class: "cv-grid", x1: at, y1: top, x2: at, y2: bottom }));
      if (titles.x) scene.append(text("cv-tick", [at, bottom + 15], short(value), { "text-anchor": "middle" }));
    }
    for (const value of ticks(y, Math.max(2, Math.floor(height / 32)))) {
      const at = px(y(value));
      const name = value === 0 ? "cv-grid cv-zero" : "cv-grid";
      scene.append(svg("line", { class: name, x1: left, y1: at, x2: right, y2: at }));
      scene.append(text("cv-tick", [left - 6, at + 4], short(value), { "text-anchor": "end" }));
    }
    const turned = { "text-anchor": "middle", transform: `rotate(-90 12 ${px(top + height / 2)})` };
    scene.append(text("cv-title", [12, top + height / 2], titles.y, turned));
    if (titles.x)
      scene.append(text("cv-title", [left + width / 2, bottom + 34], titles.x, { "text-anchor": "middle" }));
    const inner = svg("g", { "clip-path": `url(#${clip})` });
    scene.append(
      svg("clipPath", { id: clip }, svg("rect", { x: left, y: top, width, height })),
      inner,
      svg("rect", { class: "cv-frame", x: left, y: top, width, height }),
    );
    return inner;
  }

  // ---- the plots --------------------------------------------------------------------------------

  // All marks of a curve are one path, and so are all bars: a browser draws few nodes fast.
  // `spots`: { x, y, bar, place, bad } in pixels; the last of a curve is larger, for it may be the newest.
  function layer(plot, group, one, spots, { line, hollow }) {
    const kept = svg("g", { class: `cv-curve cv-c${one.colour}` });
    const path = (name, parts) => parts.length && kept.append(svg("path", { class: name, d: parts.join("") }));
    const marks = (list, more) =>
      list.map((spot) => shape(one.mark, spot.x, spot.y, (spot === spots[spots.length - 1] ? 5 : 3.5) + more));
    const bad = spots.filter((spot) => spot.bad);
    if (line && spots.length > 1) path("cv-line", [`M${spots.map((spot) => `${px(spot.x)},${px(spot.y)}`).join("L")}`]);
    path("cv-bar", spots.map((spot) => spot.bar).filter(Boolean));
    path(
      hollow ? "cv-mark cv-hollow" : "cv-mark",
      marks(
        spots.filter((spot) => !spot.bad),
        0,
      ),
    );
    path("cv-mark cv-hollow", marks(bad, 0.5));
    path(
      "cv-cross",
      bad.map(({ x, y }) => `M${px(x - 7)},${px(y - 7)}l14,14M${px(x + 7)},${px(y - 7)}l-14,14`),
    );
    group.append(kept);
    const { left, top, width, height } = plot.box;
    for (const { x, y, place } of spots)
      if (place >= 0 && x >= left && x <= left + width && y >= top && y <= top + height)
        plot.spots.push({ x, y, id: one.id, place });
  }

  function modelLine(s, group, model, x, y) {
    const points = model.line.filter(usable).map((p) => `${px(x(p))},${px(y(p))}`);
    const name = `cv-curve cv-c${curveOf(s, model.curve).colour}`;
    if (points.length)
      group.append(svg("g", { class: name }, svg("path", { class: "cv-model", d: `M${points.join("L")}` })));
  }

  // If a model is drawn, lines between points could be mistaken for it.
  const joined = (s, one) => !s.fitted.some((model) => model.curve === one.id);

  function drawNyquist(s, plot) {
    const view = viewOf(s, plot);
    const { left, top, width, height } = plot.box;
    const [across, tall] = [view.span / 2, (view.span / 2) * (height / width)];
    const x = d3.scaleLinear([view.x - across, view.x + across], [left, left + width]);
    const y = d3.scaleLinear([view.y - tall, view.y + tall], [top + height, top]);
    const group = frame(s, plot, plot.box, x, y, { x: s.words.re, y: s.words.im });
    const [atX, atY] = [(p) => x(1e3 * p.re_ohm), (p) => y(-1e3 * p.im_ohm)];
    const sigmas = (2e3 * width) / view.span;
    const bar = (p, cx, cy) => {
      const [dx, dy] = [sigmas * p.re_sigma_ohm, sigmas * p.im_sigma_ohm];
      return `M${px(cx - dx)},${px(cy)}H${px(cx + dx)}M${px(cx)},${px(cy - dy)}V${px(cy + dy)}`;
    };
    for (const one of s.shown) {
      const spots = one.points.map((p, place) => {
        const [cx, cy] = [atX(p), atY(p)];
        return { x: cx, y: cy, bar: known(p) && bar(p, cx, cy), place, bad: doubted(p) };
      });
      layer(plot, group, one, spots, { line: joined(s, one) });
    }
    for (const model of s.fitted) modelLine(s, group, model, atX, atY);
  }

  function frequencyScale(s, plot) {
    const view = viewOf(s, plot);
    const { left, width } = plot.box;
    const ends = [view.x - view.span / 2, view.x + view.span / 2];
    const range = [left, left + width];
    return s.log.frequency
      ? d3.scaleLog(
          ends.map((u) => 10 ** u),
          range,
        )
      : d3.scaleLinear(ends, range);
  }

  // Returns the rows whose frequency is visible, or all of them if none is.
  function sighted(rows, x) {
    const [low, high] = x.domain();
    const found = rows.filter((row) => row.freq_hz >= low && row.freq_hz <= high);
    return found.length ? found : rows;
  }

  // Values of one kind over frequency. `of` and `sigma` take a row; rows have a frequency and a place.
  function over(plot, group, one, rows, x, y, { of, sigma, line, hollow }) {
    const [low] = y.domain();
    const floor = y.base ? low / 1e3 : -Infinity;
    const spots = rows.map((row) => {
      const [at, value] = [x(row.freq_hz), of(row)];
      const reach = 2 * sigma(row);
      const ends = Number.isFinite(reach)
        ? [Math.max(floor, value - reach), value + reach].map((end) => px(y(end)))
        : null;
      return {
        x: at,
        y: y(Math.max(floor, value)),
        bar: ends && `M${px(at)},${ends[0]}V${ends[1]}`,
        place: row.place,
        bad: doubted(row),
      };
    });
    layer(plot, group, one, spots, { line, hollow });
  }

  function drawBode(s, plot) {
    const x = frequencyScale(s, plot);
    const { left, top, width, height } = plot.box;
    const half = (height - 14) / 2;
    const all = sighted(
      s.shown.flatMap((one) => one.points),
      x,
    );
    const parts = [
      { of: (p) => 1e3 * magnitude(p), sigma: (p) => 1e3 * magnitudeSigma(p), title: s.words.magnitude, least: 1e-3 },
      { of: angle, sigma: angleSigma, title: s.words.phase, least: 1 },
    ];
    parts.forEach((part, k) => {
      const box = { left, top: top + k * (half + 14), width, height: half };
      const log = k === 0 && s.log.magnitude;
      const range = around(all.map(part.of), part.least, log);
      const y = (log ? d3.scaleLog : d3.scaleLinear)(range, [box.top + half, box.top]);
      const group = frame(s, plot, box, x, y, { x: k ? s.words.frequency : "", y: part.title });
      const sigma = (p) => (known(p) ? part.sigma(p) : NaN);
      for (const one of s.shown) {
        const rows = one.points.map((p, place) => ({ ...p, place }));
        over(plot, group, one, rows, x, y, { of: part.of, sigma, line: joined(s, one) });
      }
      for (const model of s.fitted)
        modelLine(
          s,
          group,
          model,
          (p) => x(p.freq_hz),
          (p) => y(part.of(p)),
        );
    });
  }

  function drawResiduals(s, plot) {
    const x = frequencyScale(s, plot);
    const { left, top, width, height } = plot.box;
    const rows = sighted(
      s.fitted.flatMap((model) => model.residuals || []),
      x,
    );
    const range = around([-2.5, 2.5, ...rows.flatMap((row) => [row.re_sigmas, row.im_sigmas])], 0.1);
    const y = d3.scaleLinear(range, [top + height, top]);
    const group = frame(s, plot, plot.box, x, y, { x: s.words.frequency, y: s.words.sigmas });
    for (const value of [-2, 2])
      group.append(svg("line", { class: "cv-bound", x1: left, y1: px(y(value)), x2: left + width, y2: px(y(value)) }));
    for (const model of s.fitted) {
      const one = curveOf(s, model.curve);
      const placed = (model.residuals || []).map((row) => {
        const place = placeOf(one, row.freq_hz);
        return { ...row, place, verdict: (one.points[place] || {}).verdict };
      });
      const sigma = () => NaN;
      over(plot, group, { ...one, mark: 0 }, placed, x, y, { of: (row) => row.re_sigmas, sigma });
      over(plot, group, { ...one, mark: 1 }, placed, x, y, { of: (row) => row.im_sigmas, sigma, hollow: true });
    }
  }

  function drawDifference(s, plot) {
    const x = frequencyScale(s, plot);
    const { top, height } = plot.box;
    const { first, rows } = s.pair;
    const seen = sighted(rows, x);
    const unit = unitOf((d3.max(seen, magnitude) || 0) / 10);
    const size = SIZES[unit];
    const range = around([0, ...seen.flatMap((row) => [row.re_ohm / size, row.im_ohm / size])], 1e-3);
    const y = d3.scaleLinear(range, [top + height, top]);
    const titles = { x: s.words.frequency, y: put(s.words.delta, { unit }) };
    const group = frame(s, plot, plot.box, x, y, titles);
    const part = (key) => ({ of: (row) => row[`${key}_ohm`] / size, sigma: (row) => row[`${key}_sigma_ohm`] / size });
    const sure = (key) => ({ ...part(key), sigma: (row) => (known(row) ? part(key).sigma(row) : NaN), line: true });
    over(plot, group, { id: first.id, colour: 0, mark: 0 }, rows, x, y, sure("re"));
    over(plot, group, { id: first.id, colour: 1, mark: 1 }, rows, x, y, { ...sure("im"), hollow: true });
  }

  const PLOTS = {
    nyquist: { view: "near", draw: drawNyquist, tall: [0.72, 280, 460], wanted: () => true },
    bode: { view: "band", draw: drawBode, tall: [0.72, 280, 460], wanted: () => true },
    residuals: {
      view: "band",
      draw: drawResiduals,
      tall: [0.4, 190, 260],
      wanted: (s) => s.fitted.some((model) => (model.residuals || []).length),
    },
    difference: { view: "band", draw: drawDifference, tall: [0.4, 190, 260], wanted: (s) => s.pair !== null },
  };

  function makePlot(s, key) {
    const plot = { key, ...PLOTS[key], spots: [], base: null };
    plot.scene = svg("g", {});
    plot.marker = svg("g", { class: "cv-marker" });
    // The node stays while the rest is redrawn: a touch that began on a removed node would be lost.
    plot.hit = svg("rect", { class: `cv-hit cv-hit-${plot.view}` });
    plot.svg = svg("svg", { role: "img", "aria-label": s.words[key] }, plot.scene);
    // A drawing of its own: a ring that moves does not make the browser paint all curves again.
    plot.over = svg("svg", { class: "cv-over", "aria-hidden": "true" }, plot.marker, plot.hit);
    plot.holder = el("div", { class: "cv-plot" }, plot.svg, plot.over);
    zoomable(s, plot);
    const pick = (event) => {
      const found = nearest(plot, d3.pointer(event, plot.hit));
      if (found) choose(s, found.id, found.place);
      return found;
    };
    plot.hit.addEventListener("pointermove", (event) => !event.buttons && pick(event));
    plot.hit.addEventListener("click", (event) => pick(event) && enter(s));
    return plot;
  }

  function drawPlot(s, plot, width) {
    const height = Math.round(Math.max(plot.tall[1], Math.min(plot.tall[2], plot.tall[0] * width)));
    const box = { left: MARGIN.left, top: MARGIN.top };
    box.width = width - MARGIN.left - MARGIN.right;
    box.height = height - MARGIN.top - MARGIN.bottom;
    plot.box = box;
    plot.spots = [];
    for (const node of [plot.svg, plot.over]) node.setAttribute("viewBox", `0 0 ${width} ${height}`);
    fill(plot.hit, { x: box.left, y: box.top, width: box.width, height: box.height }, []);
    plot.scene.replaceChildren();
    if (!s.bounds) {
      const [x, y] = middle(box);
      plot.scene.append(svg("text", { class: "cv-none", x, y, "text-anchor": "middle" }, s.words.empty));
      return;
    }
    const caption = put(s.words[`${plot.key}Caption`], { model: s.model });
    plot.scene.append(svg("text", { class: "cv-caption", x: 8, y: 15 }, caption));
    plot.draw(s, plot);
  }

  function draw(s) {
    cancelAnimationFrame(s.waiting);
    s.waiting = 0;
    settle(s);
    const wanted = Object.values(s.plots).filter((plot) => plot.wanted(s));
    if (wanted.length !== s.area.childElementCount || wanted.some((plot) => !plot.holder.parentNode))
      s.area.replaceChildren(...wanted.map((plot) => plot.holder));
    // Measured before any other change, so that the browser does not lay out the page twice.
    const widths = wanted.map((plot) => Math.max(240, plot.holder.clientWidth || 480));
    s.width = s.area.clientWidth;
    drawTools(s);
    drawLegend(s);
    wanted.forEach((plot, k) => drawPlot(s, plot, widths[k]));
    mark(s);
    say(s.compared, comparison(s));
    drawTable(s);
  }

  // ---- the selected point ------------------------------------------------------------------------

  function nearest(plot, [x, y]) {
    let [best, least] = [null, REACH];
    for (const spot of plot.spots) {
      const far = Math.hypot(spot.x - x, spot.y - y);
      if (far < least) [best, least] = [spot, far];
    }
    return best;
  }

  const activePoint = (s) => curveOf(s, s.active.id).points[s.active.place];

  function choose(s, id, place) {
    if (s.active && s.active.id === id && s.active.place === place) return;
    s.active = { id, place, freq_hz: curveOf(s, id).points[place].freq_hz };
    mark(s);
  }

  // Highlights the selected point in all plots, and shows its values as text.
  function mark(s) {
    for (const plot of Object.values(s.plots)) {
      const same = (spot) => s.active && spot.id === s.active.id && spot.place === s.active.place;
      const rings = plot.spots.filter(same);
      plot.marker.replaceChildren(
        ...rings.flatMap(({ x, y }) => [
          svg("circle", { class: "cv-ring-back", cx: px(x), cy: px(y), r: 9 }),
          svg("circle", { class: "cv-ring", cx: px(x), cy: px(y), r: 9 }),
        ]),
      );
    }
    say(s.status, s.active ? describePoint(s) : s.words.nothing);
  }

  function describePoint(s) {
    const p = activePoint(s);
    const unit = unitOf(magnitude(p));
    return put(s.words.point, {
      curve: curveOf(s, s.active.id).name,
      freq: frequency(p.freq_hz),
      re: measured(s, p.re_ohm, p.re_sigma_ohm, unit),
      im: measured(s, p.im_ohm, p.im_sigma_ohm, unit),
      magnitude: `${digits(magnitude(p) / SIZES[unit], 5)} ${unit}`,
      phase: minus(angle(p).toFixed(2)),
      verdict: verdict(s, p),
    });
  }

  function enter(s) {
    if (!s.active || !s.onPoint) return;
    const one = curveOf(s, s.active.id);
    if (one.source !== FILE) s.onPoint(one.given, activePoint(s));
  }

  const filled = (s) => s.shown.filter((one) => one.points.length);

  // Selects the next point of the curve, or the first if none is selected.
  function walk(s, by) {
    const curves = filled(s);
    if (!curves.length) return;
    const one = s.active ? curveOf(s, s.active.id) : curves[0];
    const place = s.active ? s.active.place + by : 0;
    choose(s, one.id, Math.max(0, Math.min(one.points.length - 1, place)));
    reveal(s);
  }

  // Selects the point of the next curve with the nearest frequency.
  function change(s, by) {
    const curves = filled(s);
    if (!s.active || !curves.length) return walk(s, 0);
    const from = curves.findIndex((one) => one.id === s.active.id);
    const one = curves[(from + by + curves.length) % curves.length];
    const far = (p) => Math.abs(Math.log(p.freq_hz / s.active.freq_hz));
    choose(s, one.id, d3.minIndex(one.points, far));
    reveal(s);
  }

  const KEYS = {
    ArrowRight: (s) => walk(s, 1),
    ArrowLeft: (s) => walk(s, -1),
    ArrowDown: (s) => change(s, 1),
    ArrowUp: (s) => change(s, -1),
    Enter: enter,
    "+": (s) => zoomBy(s, STEP),
    "=": (s) => zoomBy(s, STEP),
    "-": (s) => zoomBy(s, 1 / STEP),
    0: zoomOff,
  };

  // With a modifier a key is the browser's or the page's.
  function press(s, event) {
    if (event.ctrlKey || event.metaKey || event.altKey || !Object.hasOwn(KEYS, event.key)) return;
    event.preventDefault();
    KEYS[event.key](s);
  }

  // ---- tools, legend and table ------------------------------------------------------------------

  function options(select, list, value) {
    const key = JSON.stringify(list);
    if (select.dataset.list !== key) select.replaceChildren(...list.map(([id, name]) => new Option(name, id)));
    select.dataset.list = key;
    if (select.value !== value) select.value = value;
  }

  function makeTools(s) {
    const { words } = s;
    const button = (text, onclick, more) => el("button", { type: "button", onclick, ...more }, text);
    const select = (name, set) => {
      const box = el("select", { onchange: () => (set(box.value), draw(s)) });
      return [box, el("label", { class: "cv-choice" }, `${name} `, box)];
    };
    const toggle = (text, key) => button(text, () => ((s.log[key] = !s.log[key]), (s.views.band = null), draw(s)));
    const sign = (text, name, factor) =>
      button(text, () => zoomBy(s, factor), { "aria-label": `${text} ${name}`, title: `${name}. ${words.zoomHint}` });
    const [model, modelLabel] = select(words.model, (value) => (s.wanted = value));
    const [first, firstLabel] = select(words.compare, (value) => (s.base = value));
    const [second, secondLabel] = select(words.compareWith, (value) => (s.against = value));
    second.addEventListener("change", () => {
      // Selecting a curve of a file shows it.
      const one = curveOf(s, second.value);
      if (one && one.source === FILE && s.hidden.delete(one.id)) draw(s);
      say(s.said, s.compared.textContent);
    });
    const paper = el("input", { type: "checkbox", checked: "" });
    const save = (kind, make) => button(put(words.save, { kind }), () => download(s, kind, make));
    s.tools = { model, modelLabel, first, firstLabel, second, secondLabel, paper };
    s.tools.files = el("span", { class: "cv-choice", hidden: "" });
    s.tools.magnitude = toggle(words.logMagnitude, "magnitude");
    s.tools.frequency = toggle(words.logFrequency, "frequency");
    return el(
      "div",
      { class: "cv-tools", role: "group", "aria-label": words.tools },
      sign("+", words.zoomIn, STEP),
      sign("−", words.zoomOut, 1 / STEP),
      button(words.whole, () => zoomOff(s), { title: words.zoomHint }),
      s.tools.magnitude,
      s.tools.frequency,
      modelLabel,
      firstLabel,
      secondLabel,
      s.tools.files,
      save("SVG", () => sheet(s).text),
      save("PNG", () => picture(s)),
      save("CSV", () => csv(s)),
      el("label", { class: "cv-choice" }, paper, ` ${words.paper}`),
    );
  }

  function drawTools(s) {
    const { tools, words } = s;
    for (const key of ["magnitude", "frequency"]) tools[key].setAttribute("aria-pressed", String(s.log[key]));
    const named = (list) => list.map((one) => [one.id, one.name]);
    options(tools.model, [["", words.none], ...s.names.map((name) => [name, name])], s.model);
    const others = s.curves.filter((one) => one !== s.first);
    options(tools.second, [["", words.none], ...named(others)], s.pair ? s.pair.second.id : "");
    options(tools.first, named(s.curves), s.first ? s.first.id : "");
    tools.modelLabel.hidden = !s.names.length;
    tools.firstLabel.hidden = tools.secondLabel.hidden = s.curves.length < 2;
  }

  const sample = (one) =>
    svg("svg", { viewBox: "0 0 34 14", class: "cv-sample", "aria-hidden": "true" }, sampleOf(one));

  function sampleOf(one) {
    const line = svg("path", { class: "cv-line", d: "M1,7H33" });
    const mark = svg("path", { class: "cv-mark", d: shape(one.mark, 17, 7, 4) });
    return svg("g", { class: `cv-curve cv-c${one.colour}` }, line, mark);
  }

  function legendText(s, one) {
    const count = `${one.points.length} ${one.points.length === 1 ? s.words.onePoint : s.words.points}`;
    return `${one.name} (${count}${one.given.corrected ? "" : `, ${s.words.asRead}`})`;
  }

  // The buttons keep their nodes, so that focus and clicks are not lost.
  function drawLegend(s) {
    const turn = (_, one) => {
      if (!s.hidden.delete(one.id)) s.hidden.add(one.id);
      draw(s);
    };
    const made = (one) => el("button", { type: "button" }, sample(one), el("span", { class: "cv-name" }));
    d3.select(s.legend)
      .selectAll("button")
      .data(s.curves, (one) => `${one.id} ${one.colour} ${one.mark}`)
      .join((entered) => entered.append(made).on("click", turn))
      .attr("aria-pressed", (one) => String(!s.hidden.has(one.id)))
      .each((one, k, nodes) => say(nodes[k].lastChild, legendText(s, one)));
    const notes = [s.words.bars];
    if (s.shown.some((one) => one.points.some(doubted))) notes.push(s.words.doubtedMark);
    if (s.model) notes.push(put(s.words.modelLine, { model: s.model }));
    say(s.notes, notes.join("; "));
  }

  function makeTable(s) {
    const { words } = s;
    s.rows = el("tbody", {});
    const head = el("thead", {}, el("tr", {}, ...words.head.map((name) => el("th", { scope: "col" }, name))));
    const table = el("table", {}, el("caption", {}, words.tableCaption), head, s.rows);
    const frame = el(
      "div",
      { class: "cv-table", role: "region", tabindex: 0, "aria-label": words.tableCaption },
      table,
    );
    s.details = el("details", { ontoggle: () => drawTable(s) }, el("summary", {}, words.table), frame);
  }

  // Drawn only while it is visible, and only changes: it has by far the most nodes.
  function drawTable(s) {
    if (!s.details.open) return;
    const micro = (sigma) => (Number.isFinite(sigma) ? digits(1e6 * sigma, 3) : s.words.unknown);
    const cells = ({ name, p }) => [
      name,
      digits(p.freq_hz, 5),
      digits(1e3 * p.re_ohm, 6),
      digits(1e3 * p.im_ohm, 6),
      micro(p.re_sigma_ohm),
      micro(p.im_sigma_ohm),
      verdict(s, p),
    ];
    const rows = s.shown.flatMap(({ id, name, points }) => points.map((p, k) => ({ key: `${id} ${k}`, name, p })));
    d3.select(s.rows)
      .selectAll("tr")
      .data(rows, (row) => row.key)
      .join((entered) => entered.append(() => el("tr", {}, ...s.words.head.map(() => el("td", {})))))
      .each((row, k, nodes) => cells(row).forEach((text, place) => say(nodes[k].children[place], text)));
  }

  // ---- files ------------------------------------------------------------------------------------

  // Escapes text that a spreadsheet would execute as a formula.
  function csvText(text) {
    const harmless = /^[=+\-@\t\r]/.test(text) ? `'${text}` : text;
    return /[",\r\n]/.test(harmless) ? `"${harmless.replaceAll('"', '""')}"` : harmless;
  }

  function csv(s) {
    const lines = s.shown.flatMap((one) =>
      one.points.map((p) =>
        [
          csvText(one.name),
          ...[p.freq_hz, p.re_ohm, p.im_ohm, p.re_sigma_ohm, p.im_sigma_ohm].map((value) => value ?? ""),
          csvText(p.verdict ?? ""),
        ].join(","),
      ),
    );
    return ["curve,freq_hz,re_ohm,im_ohm,re_sigma_ohm,im_sigma_ohm,verdict", ...lines, ""].join("\r\n");
  }

  const STYLES = ["fill", "stroke", "stroke-width", "stroke-dasharray", "opacity"];
  const LETTERS = ["font-family", "font-size", "font-weight"];

  // The legend in as many columns as there is room for; returns the nodes and their height.
  function sheetLegend(s, width) {
    const wide = 60 + 7.5 * d3.max(s.shown, (one) => legendText(s, one).length);
    const columns = Math.max(1, Math.floor(width / wide));
    const entries = s.shown.map((one, k) => {
      const at = `translate(${px((k % columns) * wide + 8)} ${22 * Math.floor(k / columns) + 8})`;
      return svg("g", { transform: at }, sampleOf(one), svg("text", { x: 40, y: 12 }, legendText(s, one)));
    });
    const tall = 22 * Math.ceil(s.shown.length / columns) + 8;
    return [[...entries, svg("text", { class: "cv-tick", x: 8, y: tall + 12 }, s.notes.textContent)], tall + 24];
  }

  // All plots as on the page, in one drawing without a style sheet.
  function sheet(s) {
    const outer = s.area.getBoundingClientRect();
    const [width, height] = [Math.ceil(outer.width), Math.ceil(outer.height)];
    const [legend, top] = s.shown.length ? sheetLegend(s, width) : [[], 0];
    const parts = Object.values(s.plots)
      .filter((plot) => plot.holder.parentNode)
      .map((plot) => {
        const at = plot.svg.getBoundingClientRect();
        const place = `translate(${px(at.left - outer.left)} ${px(at.top - outer.top + top)})`;
        return svg("g", { transform: place }, plot.scene.cloneNode(true));
      });
    const ground = svg("rect", { class: "cv-ground", width, height: height + top });
    const size = { width, height: height + top, viewBox: `0 0 ${width} ${height + top}` };
    const page = svg("svg", { class: "cv-sheet", "aria-hidden": "true", ...size }, ground, ...legend, ...parts);
    if (s.tools.paper.checked) page.classList.add("cv-paper");
    // Computed styles exist only while the drawing is in the page.
    s.root.append(page);
    const written = [...page.querySelectorAll("*")].map((node) => {
      const style = getComputedStyle(node);
      const keys = node.localName === "text" ? [...STYLES, ...LETTERS] : STYLES;
      return [node, node.localName === "g" ? [] : keys.map((key) => [key, style.getPropertyValue(key)])];
    });
    page.remove();
    for (const [node, styles] of written) {
      for (const [key, value] of styles) node.setAttribute(key, value);
      node.removeAttribute("class");
    }
    page.removeAttribute("class");
    page.removeAttribute("aria-hidden");
    return { text: new XMLSerializer().serializeToString(page), width, height: height + top };
  }

  async function picture(s) {
    const { text, width, height } = sheet(s);
    const image = new Image();
    image.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(text)}`;
    await image.decode();
    const canvas = el("canvas", { width: 2 * width, height: 2 * height });
    canvas.getContext("2d").drawImage(image, 0, 0, 2 * width, 2 * height);
    return new Promise((done) => canvas.toBlob(done, "image/png"));
  }

  const TYPES = { SVG: "image/svg+xml", PNG: "image/png", CSV: "text/csv;charset=utf-8" };

  async function download(s, kind, make) {
    try {
      const { run, file, name } = s.shown.length ? s.shown[0].given : {};
      const stem = `${s.words.file}-${run || file || name || ""}`.replace(/[^A-Za-z0-9_-]+/g, "_").slice(0, 80);
      const href = URL.createObjectURL(new Blob([await make()], { type: TYPES[kind] }));
      const link = el("a", { href, download: `${stem}.${kind.toLowerCase()}` });
      link.click();
      setTimeout(() => URL.revokeObjectURL(href), 10000);
      say(s.said, put(s.words.saved, { file: link.download }));
    } catch (error) {
      say(s.said, put(s.words.notSaved, { why: error.message }));
    }
  }

  // ---- files that somebody brings ---------------------------------------------------------------

  // Names a curve by the file's name and its name in the file; the only curve has the file's name.
  function curvesOf(s, file, spectra) {
    const called = (name) => (name.startsWith(`${file}#`) ? name.slice(file.length + 1) : name);
    const name = (one) => (spectra.length > 1 ? put(s.words.fileOf, { file, name: called(one.name) }) : file);
    return spectra.map((one, k) => ({ ...one, id: JSON.stringify(["file", file, k]), name: name(one) }));
  }

  // Shows and compares the first spectrum of a file; earlier curves of the file are removed.
  function bring(s, file, { spectra, notes }) {
    takeOut(s, file);
    const curves = curvesOf(s, file, spectra);
    s.files.push({ name: file, curves });
    s.against = curves[0].id;
    take(s, s.given);
    s.hidden.delete(s.against);
    draw(s);
    const words = curves.length > 1 ? s.words.fileRead : s.words.fileReadOne;
    const message = put(words, { file, count: curves.length, name: curves[0].name });
    say(s.said, s.compared.textContent);
    return [message, ...notes].join("\n");
  }

  function takeOut(s, file) {
    const found = s.files.find((one) => one.name === file);
    if (!found) return;
    s.files = s.files.filter((one) => one !== found);
    const gone = new Set(found.curves.map((one) => one.id));
    if (gone.has(s.against)) s.against = null;
    if (gone.has(s.base)) s.base = null;
    for (const id of gone) s.seen.delete(id);
    take(s, s.given);
  }

  // Reads files one after the other; a file that cannot be read leaves the plots unchanged.
  async function readAll(s, files) {
    const lines = [];
    for (const file of files) {
      say(s.fileSaid, [...lines, put(s.words.reading, { file: file.name })].join("\n"));
      try {
        lines.push(bring(s, file.name, await s.read(file)));
      } catch (error) {
        const why = error.message;
        lines.push(why.startsWith(file.name) ? why : put(s.words.fileFailed, { file: file.name, why }));
      }
      say(s.fileSaid, lines.join("\n"));
      drawFiles(s);
    }
  }

  function drawFiles(s) {
    const out = (event, file) => {
      takeOut(s, file.name);
      draw(s);
      drawFiles(s);
      say(s.fileSaid, "");
      s.tools.files.querySelector("button").focus();
    };
    d3.select(s.fileList)
      .selectAll("button")
      .data(s.files, (file) => file.name)
      .join((entered) => entered.append(() => el("button", { type: "button" })).on("click", out))
      .each((file, k, nodes) => say(nodes[k], put(s.words.takeOut, { file: file.name })));
  }

  // Offers comparison with files; `read` returns the spectra of a file, or throws the reason.
  function offerFiles(s, read) {
    const { words } = s;
    s.read = read;
    const input = el("input", { type: "file", multiple: "", hidden: "" });
    input.addEventListener("change", () => {
      const files = [...input.files];
      // The same file can be selected again, because it may have changed.
      input.value = "";
      readAll(s, files);
    });
    const ask = { type: "button", title: words.fileHint, onclick: () => input.click() };
    const button = el("button", ask, words.compareFile);
    s.tools.files.append(button, input);
    s.tools.files.hidden = false;
    const held = (event) => [...(event.dataTransfer || { types: [] }).types].includes("Files");
    const over = (event) => {
      s.root.classList.toggle("cv-drop", event.type === "dragover" && held(event));
      if (held(event)) event.preventDefault();
    };
    for (const kind of ["dragover", "dragleave", "drop"]) s.root.addEventListener(kind, over);
    s.root.addEventListener("drop", (event) => held(event) && readAll(s, [...event.dataTransfer.files]));
  }

  // ---- the panel --------------------------------------------------------------------------------

  let panels = 0;

  function build(s, parent) {
    const { words } = s;
    const id = `cv-hint-${s.number}`;
    const hint = s.onPoint ? `${words.hint} ${words.hintEnter}` : words.hint;
    s.plots = Object.fromEntries(Object.keys(PLOTS).map((key) => [key, makePlot(s, key)]));
    s.legend = el("div", { class: "cv-legend", role: "group", "aria-label": words.legend });
    s.notes = el("p", { class: "cv-notes" });
    const name = { "aria-label": words.area, "aria-describedby": id };
    s.area = el("div", { class: "cv-area", role: "application", tabindex: 0, ...name });
    s.area.addEventListener("keydown", (event) => press(s, event));
    s.status = el("p", { class: "cv-status", "aria-live": "polite" });
    s.compared = el("p", { class: "cv-compared" });
    s.said = el("p", { class: "cv-said", role: "status" });
    makeTable(s);
    s.fileList = el("div", { class: "cv-files", role: "group", "aria-label": words.files });
    s.fileSaid = el("p", { class: "cv-filesaid", role: "status" });
    const texts = [s.status, s.compared, s.said, el("p", { class: "cv-hint", id }, hint)];
    const files = [s.fileList, s.fileSaid];
    s.root = el("div", { class: "cv" }, makeTools(s), ...files, s.legend, s.notes, s.area, ...texts, s.details);
    parent.append(s.root);
    // In a report `fit` is never called, and a hidden page had no width.
    new ResizeObserver(() => s.area.clientWidth !== s.width && later(s)).observe(s.area);
  }

  function panel(parent, { onPoint, words } = {}) {
    const s = {
      words: { ...WORDS, ...words },
      onPoint,
      number: (panels += 1),
      curves: [],
      models: [],
      given: { curves: [] },
      files: [],
      read: null,
      seen: new Set(),
      hidden: new Set(),
      log: { magnitude: false, frequency: true },
      views: { near: null, band: null },
      // The user's choice: null before the first choice.
      wanted: null,
      base: null,
      against: null,
      active: null,
      busy: null,
      waiting: 0,
    };
    build(s, parent);
    draw(s);
    const show = (given) => {
      take(s, given);
      draw(s);
    };
    return { show, fit: () => draw(s), offerFiles: (read) => offerFiles(s, read) };
  }

  window.eisCurves = { panel };
})();
