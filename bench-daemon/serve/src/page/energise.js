// The question before everything that starts a current: the bench, the duration, the charge and the margins to the
// limits. All parts of the page ask it in the same way.
"use strict";

import { duration, el } from "./bench.js";
import { Refused } from "./server.js";

const WORDS = {
  head: (bench) => `On the bench ${bench} a current will flow.`,
  long: (expected, longest) => `For about ${expected}, ${longest} at most.`,
  charge: (words) => `Charge moved: ${words}.`,
  chargeWords: (in_, out) => `${in_} in, ${out} out`,
  margins: "Margins to the limits",
  margin: (quantity, words) => `${quantity}: ${words}`,
  noMargins: "No limits are stated.",
  left: (by, unit) => `${by} ${unit} left`,
  only: (by, unit) => `▲ only ${by} ${unit} left`,
  beyond: (by, unit) => `▲ beyond by ${by} ${unit}`,
  unknown: "margin not known",
  noPlan: "The duration, the charge and the margins are not known.",
  mistake: ({ field, message }) => `▲ The experiment has a mistake: ${field ? `${field}: ` : ""}${message}`,
  beyondLimit: "▲ This plan goes beyond a limit. It is not started from here.",
  beyondNow: "▲ The whole plan goes beyond a limit of today's files. The run goes on with its own frozen files.",
  not: "Not now",
  sending: "Being sent …",
  refused: (why) => `✕ Not started: ${why}`,
  lost: (why) =>
    `▲ No answer (${why}): it is NOT known whether it was taken. Look at the bench and its queue before it is sent ` +
    "again.",
};

const SMALL_MARGIN = 0.1;
const DIGITS = { V: 3, A: 2, "°C": 1 };

export const known = (value) => value !== null && value !== undefined;
export const figure = (value, unit) => (known(value) ? value.toFixed(DIGITS[unit] ?? 2).replace("-", "−") : "…");
const ampHours = (coulombs) => `${(coulombs / 3600).toPrecision(3)} Ah`;

// Returns the charge of a plan as text; empty if it is not known.
export function chargeWords({ charge_c, discharge_c }) {
  return known(charge_c) && known(discharge_c) ? WORDS.chargeWords(ampHours(charge_c), ampHours(discharge_c)) : "";
}

const isBeyond = ({ margin }) => known(margin) && margin < 0;

// Returns the level of a margin, and its text.
export function marginWords({ unit, margin, least, greatest }) {
  if (!known(margin)) return ["near", WORDS.unknown];
  const by = unit === "°C" ? "K" : unit;
  if (margin < 0) return ["bad", WORDS.beyond(figure(-margin, unit), by)];
  const range = known(greatest) ? greatest - (known(least) ? least : Math.min(0, greatest)) : 0;
  const isSmall = range > 0 && margin < (SMALL_MARGIN * range) / 2;
  return isSmall ? ["near", WORDS.only(figure(margin, unit), by)] : ["good", WORDS.left(figure(margin, unit), by)];
}

// Returns why a plan is not started; empty if nothing prevents it.
function whyNot(draft, goesOn) {
  if (draft && draft.mistakes.length) return WORDS.mistake(draft.mistakes[0]);
  if (!draft || !draft.margins.some(isBeyond)) return "";
  return goesOn ? WORDS.beyondNow : WORDS.beyondLimit;
}

// Returns one draft for runs that follow each other: sums, all mistakes, and the smallest margin of each quantity.
export function together(drafts) {
  const margins = new Map();
  for (const one of drafts.flatMap((draft) => draft.margins)) {
    const before = margins.get(one.quantity);
    const isSmaller = !before || !known(one.margin) || (known(before.margin) && one.margin < before.margin);
    if (isSmaller) margins.set(one.quantity, one);
  }
  const plans = drafts.map((draft) => draft.plan);
  const isKnown = (key) => plans.every((plan) => known(plan[key]));
  const sum = (key) => (isKnown(key) ? plans.reduce((all, plan) => all + plan[key], 0) : null);
  const keys = ["expected_s", "longest_s", "charge_c", "discharge_c"];
  const plan = plans.every(Boolean) ? Object.fromEntries(keys.map((key) => [key, sum(key)])) : null;
  return { plan, mistakes: drafts.flatMap((draft) => draft.mistakes), margins: [...margins.values()] };
}

// What a plan does, as text.
function planned({ plan, margins } = {}) {
  if (!plan) return [el("p", {}, WORDS.noPlan)];
  const charge = chargeWords(plan);
  const margin = (one) => {
    const [level, words] = marginWords(one);
    return el("li", { class: level === "good" ? "" : level }, WORDS.margin(one.quantity, words));
  };
  return [
    el("p", {}, WORDS.long(duration(plan.expected_s), duration(plan.longest_s))),
    charge ? el("p", {}, WORDS.charge(charge)) : null,
    el("p", {}, margins.length ? `${WORDS.margins}:` : WORDS.noMargins),
    margins.length ? el("ul", {}, ...margins.map(margin)) : null,
  ];
}

export function close(place) {
  place.hidden = true;
  place.replaceChildren();
}

// Asks in `place` before a current flows. `of` has the `bench`, the `draft` of the plan if it is known, the `title` and
// the label `go`; `send` starts it, `done` gets its answer, and `back` gets the focus afterwards. A plan
// with a mistake or beyond a limit can only be started if `goesOn`: it is part of a run that began before.
export function ask(place, { bench, draft, title, go, send, done, back, goesOn }) {
  // The answer to an earlier question is on its way.
  if (place.dataset.sending) return;
  const said = el("p", { role: "alert", class: "bad" });
  const why = whyNot(draft, goesOn);
  said.textContent = why;
  const not = el("button", { type: "button" }, WORDS.not);
  not.addEventListener("click", () => {
    close(place);
    if (back) back.focus();
  });
  const yes = el("button", { type: "button", class: "go" }, go);
  yes.addEventListener("click", async () => {
    yes.disabled = true;
    place.dataset.sending = "yes";
    said.textContent = WORDS.sending;
    try {
      const answer = await send();
      delete place.dataset.sending;
      close(place);
      if (back) back.focus();
      done(answer);
    } catch (error) {
      said.textContent = (error instanceof Refused ? WORDS.refused : WORDS.lost)(error.message);
      not.focus();
    } finally {
      delete place.dataset.sending;
    }
  });
  const head = el("strong", {}, WORDS.head(bench));
  place.setAttribute("aria-label", head.textContent);
  place.replaceChildren(
    el("p", {}, head, title ? ` ${title}` : ""),
    ...planned(draft || {}).filter(Boolean),
    said,
    el("div", { class: "acts" }, why && !goesOn ? null : yes, not),
  );
  place.hidden = false;
  place.scrollIntoView({ block: "nearest" });
  // The focus starts at the button that cancels, so that a held key starts nothing.
  not.focus();
}

// The place of the question.
export const placeOf = (name) => el("div", { id: name, class: "confirm", role: "group", hidden: true });
