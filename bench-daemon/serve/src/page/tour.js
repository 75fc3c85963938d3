// The first steps on a bench for new users: each is ticked when it is done, and the list can be dismissed permanently.
"use strict";

import { $, el, fill } from "./bench.js";

const WORDS = {
  title: "First steps",
  done: "✓ done: ",
  begin: "Begin a run: choose an experiment, look at its plan, submit it.",
  beginLink: "Choose an experiment",
  watch: "Watch it here. STOP, Esc twice or Shift+S ends it in safe state at any time.",
  spectrum: "Look into its spectrum: press Enter at a point to see the record behind it.",
  spectrumLink: (run) => `Open ${run}`,
  diagnose: "Ask what its model lacks, and what to measure next.",
  diagnoseLink: "Diagnose it",
  pack: "Put its cell into a pack, and drag the load.",
  packLink: "Open the pack",
  close: "Do not show this again",
};

const CHOICE = "first steps";
// Addresses that were seen since the page was opened first.
const SEEN = { spectrum: "#/run/", diagnose: "#/analysis/", pack: "#/pack" };

const kept = () => {
  try {
    return JSON.parse(localStorage.getItem(CHOICE)) || {};
  } catch {
    return {};
  }
};

const keep = (more) => localStorage.setItem(CHOICE, JSON.stringify({ ...kept(), ...more }));

// Notes which part of the page was opened.
export function noteTour() {
  for (const [step, address] of Object.entries(SEEN)) if (location.hash.startsWith(address)) keep({ [step]: true });
}

export function drawTour(runs) {
  const seen = kept();
  const finished = runs.find((job) => job.ended && job.ended.finished);
  const run = finished && finished.item.run;
  const query = new URLSearchParams({ runs: run || "", kind: "diagnose" });
  const steps = [
    [runs.length > 0, WORDS.begin, WORDS.beginLink, "#/new"],
    [runs.some((job) => job.ended), WORDS.watch, null, null],
    [seen.spectrum, WORDS.spectrum, run && WORDS.spectrumLink(run), `#/run/${encodeURIComponent(run)}`],
    [seen.diagnose, WORDS.diagnose, run && WORDS.diagnoseLink, `#/analyses?${query}`],
    [seen.pack, WORDS.pack, run && WORDS.packLink, "#/pack"],
  ];
  $("tour").hidden = Boolean(seen.closed) || steps.every(([done]) => done);
  if ($("tour").hidden) return;
  const close = () => {
    keep({ closed: true });
    $("tour").hidden = true;
    $("now-h").focus();
  };
  const item = ([done, words, name, address]) =>
    el(
      "li",
      { class: done ? "quiet" : "" },
      done ? WORDS.done : "",
      `${words} `,
      !done && name ? el("a", { href: address }, name) : "",
    );
  fill(
    $("tour"),
    el("h2", { id: "tour-h" }, WORDS.title),
    el("ol", {}, ...steps.map(item)),
    el("button", { type: "button", onclick: close }, WORDS.close),
  );
}
