// Shared by the views of the catalogue, of a run, of a cell and of the fleet: tables of runs, verdicts as text, rows
// that keep the focus.
"use strict";

import { el, minus, person, when } from "./bench.js";

const WORDS = {
  columns: {
    compare: "Compare",
    run: "Run",
    bench: "Bench",
    experiment: "Experiment",
    cells: "Cells",
    when: "Started",
    by: "By",
    how: "Outcome",
    verdict: "Verdict",
    tags: "Tags",
    notes: "Notes",
  },
  map: ({ soc_low, soc_high, temperature_low_c, temperature_high_c, left_out_mv }) =>
    `map: ${Math.round(100 * soc_low)} to ${Math.round(100 * soc_high)} % of charge, ` +
    minus(`${temperature_low_c.toFixed(1)} to ${temperature_high_c.toFixed(1)} °C`) +
    (left_out_mv === null ? "" : `, ${left_out_mv.toFixed(1)} mV left out`),
  unnamed: "–",
  noPlots: "The part of the page that draws spectra is missing; reload the page.",
  serial: (cell) => `${cell.name}${cell.serial ? ` (${cell.serial})` : ""}`,
  lack: (scope, have) => `needs the scope ${scope}; your token has ${have.length ? have.join(", ") : "none"}`,
  verdicts: {
    good: ["✓", "good", "good"],
    doubtful: ["▲", "doubtful", "note"],
    stopped: ["■", "stopped", "note"],
    failed: ["✕", "failed", "bad"],
    "in work": ["▶", "in work", "on"],
    unfinished: ["…", "unfinished", "note"],
    damaged: ["✕", "damaged", "bad"],
  },
};

const SCOPES = ["read", "operate", "energise", "clear-trip"];
// Events come in bursts; this is the minimum interval between two requests of the lists.
export const CALM_MS = 1000;

// ---- shared -------------------------------------------------------------------------------------

export const address = (...parts) => `#/${parts.map(encodeURIComponent).join("/")}`;

// Returns why the user may not do something, as text, or null if it is allowed.
export function lack(ctx, scope) {
  return ctx.may(scope)
    ? null
    : WORDS.lack(
        scope,
        SCOPES.filter((one) => ctx.may(one)),
      );
}

// Shows a verdict as a symbol, a word and a colour.
export function verdict(name) {
  const [sign, words, colour] = WORDS.verdicts[name] || ["?", name, "quiet"];
  return el("span", { class: `fd-verdict ${colour}` }, el("span", { "aria-hidden": "true" }, `${sign} `), words);
}

// Display name of a spectrum: `raw_fake_cell` is the fake cell, `spectra/A_1` is A 1.
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

// Returns the position of the focus within `parent`: the row, and the control in it.
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

// Updates the rows of `parent` to `items`. A row with unchanged content keeps its node, so that focus, scroll position
// and a press of a button survive. If the focused row is removed, its neighbour or `spare` gets the focus.
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
// A cell of names, which may be long: they wrap where necessary, but not into single letters.
export const names = (name, ...children) => cell(name, el("div", { class: "fd-name" }, ...children));

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

// A run as the catalogue has it.
export function runCells(run) {
  const heads = WORDS.columns;
  return [
    el(
      "th",
      { scope: "row" },
      el("div", { class: "fd-name" }, el("a", { href: address("run", run.name) }, run.name)),
      run.map ? el("small", {}, WORDS.map(run.map)) : "",
    ),
    names(heads.bench, el("a", { href: `#${encodeURIComponent(run.bench)}` }, run.bench)),
    names(heads.experiment, run.experiment),
    names(heads.cells, ...cellLinks(run.cells)),
    cell(heads.when, when(run.started_unix_s)),
    names(heads.by, run.operator ? person(run.operator) : WORDS.unnamed),
    names(heads.how, run.damage.join("; ") || run.how || WORDS.unnamed),
    cell(heads.verdict, verdict(run.verdict)),
    names(heads.tags, ...(run.tags || []).map((tag) => el("span", { class: "fd-tag" }, tag))),
    cell(heads.notes, String(run.notes || 0)),
  ];
}

export const cellLinks = (cells) =>
  cells.flatMap((one, place) => {
    const link = el("a", { href: address("cell", one.name) }, WORDS.serial(one));
    return [el("span", { class: "fd-one" }, link, place < cells.length - 1 ? "," : ""), " "];
  });

// Cache of spectra of runs, each requested once.
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

// A curve in the format of the panel, with the data for requests of its points.
export const curve = (run, spectrum, name) => ({
  ...spectrum,
  id: JSON.stringify([run, spectrum.name]),
  run,
  spectrum: spectrum.name,
  name,
});

// The panel that draws spectra; it follows the width of `parent` automatically.
export function plot(parent, onPoint) {
  if (window.eisCurves) return window.eisCurves.panel(parent, { onPoint });
  parent.replaceChildren(el("p", { class: "bad" }, WORDS.noPlots));
  return { show: () => {} };
}
