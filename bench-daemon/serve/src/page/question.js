// The question of a run to the person at the bench: what to change in the jig, and the button that confirms it. It is
// redrawn only when another question waits, so that no typed text or tick is lost.
"use strict";

import { $, el, fill, text } from "./bench.js";

const WORDS = {
  title: (bench, isReader) => `${bench} waits for ${isReader ? "a person at the jig" : "you"}`,
  safe: "Every output that the program switches is off. It can still conduct: do not short the terminals.",
  terminal: "The question is asked on the terminal where the run was started: answer it there.",
  serial: (known) => `Serial number or code on the cell, typed or scanned (asked for: ${known.join(" or ")})`,
  optional: "If empty, the cell is not checked.",
  done: "I have changed the fixture as asked; no hands are in the jig.",
  go: "Go on: current may flow",
  first: "First tick that it is done.",
  sending: "The answer is sent …",
  readOnly: (lacks) => `To answer, the token ${lacks}.`,
};

// Draws the question of a bench into `#question`; `send(question, serial)` answers it, and returns why the answer was
// refused, or nothing; `lacks` returns why the user may not answer.
export function drawQuestion(live, send, lacks) {
  const place = $("question");
  const question = live.question;
  place.hidden = !question;
  const key = question ? `${live.bench} ${live.run && live.run.run} ${question.number} ${lacks}` : "";
  if (place.dataset.key === key) return;
  place.dataset.key = key;
  if (!question) {
    fill(place);
    return;
  }
  const heading = el("h2", {}, WORDS.title(live.bench, Boolean(lacks)));
  const task = el("p", {}, el("b", {}, question.text));
  if (question.on_terminal) {
    fill(place, heading, task, el("p", {}, WORDS.terminal));
    return;
  }
  fill(place, heading, task, el("p", {}, WORDS.safe), answer(question, send, lacks));
}

function answer(question, send, lacks) {
  const off = Boolean(lacks);
  const known = [question.serial, question.barcode].filter(Boolean);
  const done = el("input", { id: "question-done", type: "checkbox", disabled: off });
  const serial = el("input", {
    id: "question-serial",
    autocomplete: "off",
    spellcheck: false,
    maxlength: 100,
    disabled: off,
    "aria-describedby": "question-optional",
  });
  const said = el("p", { role: "alert" }, off ? WORDS.readOnly(lacks) : "");
  const say = (words, isBad) => {
    said.className = isBad ? "bad" : "";
    text(said, words);
  };
  const go = el("button", { type: "submit", disabled: off }, WORDS.go);
  const onsubmit = async (event) => {
    event.preventDefault();
    // A double press answers once, even while the question is still visible.
    if (go.getAttribute("aria-disabled")) return;
    if (!done.checked) {
      say(WORDS.first, true);
      done.focus();
      return;
    }
    say(WORDS.sending, false);
    go.setAttribute("aria-disabled", "true");
    const why = await send(question, serial.value.trim() || null);
    // A refusal is shown here, because the header may hide a message above.
    say(why, true);
    if (!why) return;
    go.removeAttribute("aria-disabled");
    (known.length ? serial : done).focus();
  };
  const named = [
    el("label", { for: "question-serial" }, WORDS.serial(known)),
    serial,
    el("p", { id: "question-optional", class: "quiet" }, WORDS.optional),
  ];
  return el(
    "form",
    { onsubmit },
    ...(known.length ? named : []),
    el("label", { class: "tick" }, done, el("span", {}, WORDS.done)),
    said,
    el("div", { class: "acts" }, go),
  );
}
