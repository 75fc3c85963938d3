// Notifications to people away from the page: targets, outcome of the latest, and a test. This browser can show them
// too, as long as the page is open in it.
"use strict";

import { el, fill, when } from "./bench.js";

const WORDS = {
  title: "Notices",
  about:
    "Notices of trips, of benches whose outputs were not read back as off, and of ended runs are sent by webhook and " +
    "by e-mail. The section [notify] of the server's file sets the addresses.",
  webhook: "Webhook",
  email: "E-mail to",
  quiet: "Quiet hours",
  none: "none",
  test: "Send a test",
  here: "Show them in this browser",
  hereOn: "Shown in this browser while the page is open",
  hereNo: "This browser does not let the page show them: allow notifications for this site.",
  latest: "The latest",
  nothing: "No notice yet.",
  head: ["When", "What", "Result"],
  needs: "needs the scope operate",
  sent: (notice) =>
    Object.entries(notice.outcome)
      .map(([target, words]) => `${target}: ${words}`)
      .join("; ") || "not sent yet",
  nowhere: "no target",
};

const CHOICE = "notices";

const parts = { ctx: null, facts: null, table: null, here: null };

// Returns whether this browser shows notifications: they are enabled and permitted.
export const tellsHere = () =>
  Boolean(window.Notification) && Notification.permission === "granted" && localStorage.getItem(CHOICE) === "on";

export function tellHere(notice) {
  if (!tellsHere()) return;
  try {
    new Notification(notice.title, { body: notice.text, tag: `eis-bench ${notice.number}` });
  } catch {
    // Some mobile browsers show notifications through a service worker only.
  }
}

function drawHere() {
  const on = tellsHere();
  parts.here.setAttribute("aria-pressed", String(on));
  parts.here.textContent = on ? WORDS.hereOn : WORDS.here;
}

async function toggleHere() {
  if (tellsHere()) localStorage.setItem(CHOICE, "off");
  else {
    const allowed = window.Notification ? await Notification.requestPermission() : "denied";
    localStorage.setItem(CHOICE, allowed === "granted" ? "on" : "off");
    if (allowed !== "granted") parts.said.textContent = WORDS.hereNo;
  }
  drawHere();
}

async function refresh() {
  const now = await parts.ctx.get("/notices");
  const rows = [
    [WORDS.webhook, now.webhook || WORDS.none],
    [WORDS.email, now.email.join(", ") || WORDS.none],
    [WORDS.quiet, now.quiet || WORDS.none],
  ];
  fill(parts.facts, ...rows.flatMap(([name, value]) => [el("dt", {}, name), el("dd", {}, value)]));
  const isTold = now.webhook || now.email.length;
  const row = (notice) =>
    el(
      "tr",
      {},
      el("td", {}, when(notice.unix_s)),
      el("td", {}, el("b", {}, notice.title), ` ${notice.text}`),
      el("td", {}, isTold ? WORDS.sent(notice) : WORDS.nowhere),
    );
  const head = el("tr", {}, ...WORDS.head.map((name) => el("th", { scope: "col" }, name)));
  const table = el("table", {}, el("thead", {}, head), el("tbody", {}, ...now.latest.map(row)));
  fill(parts.table, now.latest.length ? table : el("p", { class: "quiet" }, WORDS.nothing));
}

export async function open(parent, _, ctx) {
  const test = el("button", { type: "button", disabled: !ctx.may("operate") }, WORDS.test);
  test.addEventListener("click", async () => {
    await ctx.attempt(
      () => ctx.post("/notices/test"),
      (notice) => WORDS.sent(notice),
    );
    await ctx.attempt(refresh);
  });
  const here = el("button", { type: "button", "aria-pressed": "false", onclick: toggleHere });
  const region = { class: "scroll", role: "region", "aria-label": WORDS.latest, tabindex: 0 };
  Object.assign(parts, {
    ctx,
    here,
    facts: el("dl", { class: "facts" }),
    table: el("div", region),
    said: el("p", { class: "note", role: "status" }),
  });
  const heading = el("h2", { tabindex: -1 }, WORDS.title);
  parent.append(
    heading,
    el(
      "section",
      {},
      el("p", {}, WORDS.about),
      parts.facts,
      el("div", { class: "acts" }, test, here, ctx.may("operate") ? "" : el("span", { class: "quiet" }, WORDS.needs)),
      parts.said,
    ),
    el("section", {}, el("h3", {}, WORDS.latest), parts.table),
  );
  drawHere();
  await refresh();
  heading.focus();
}

export function heard(kind) {
  if (kind === "notice" || kind === "hello") parts.ctx.attempt(refresh);
}
