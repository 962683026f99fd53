// The selected call: what it waits for, its conditions, its attempts, what went wrong, and where its token is.

import { requestButtons } from "./controls.js";
import { timeNow } from "./model.js";
import { troubleOf } from "./tasks.js";
import { KNOWN, SIGNS, el, keepingFocus, reasons, seconds, state, stateOf, svg, words } from "./words.js";

let limits = null; // what the limits that run down are shown of
let ages = []; // what the ages of facts are shown of
let why = null; // the last answer to the question why, with the call and the record that it is about

// Shows a call; what can be done about it, if that is now.
export function showCall(model, key, detail, isNow) {
  keepingFocus(() => show(model, key, detail, isNow));
}

function show(model, key, detail, isNow) {
  limits = null;
  ages = [];
  const place = document.getElementById("detail");
  const call = model.calls.get(key);
  if (!call) {
    place.replaceChildren(el("p", { class: "soft" }, "choose a call in the plan"));
    return;
  }
  const when = (time) => (time === null ? "–" : seconds(time - model.began));
  const rows = [["state", state(call.state, call.outcome)], ["planned", call.duration === null ? seconds(call.planned) : `${seconds(call.planned)}, for ${seconds(call.duration)}`],
    ["sent, over", `${when(call.started)}, ${when(call.ended)}`]];
  if (call.is_assumed) rows.push(["effects", "◌ some are believed: nothing reports them"]);
  if (detail) {
    if (detail.server) rows.push(["server", detail.server]);
    if (detail.limit || detail.accept) rows.push(["limit", limitOf(model, key, detail, isNow)]);
    for (const [name, holder] of detail.resources) rows.push(["resource", holder ? `${name}: ${holder} has it` : `${name}: free`]);
  }
  const about = [el("p", {}, el("strong", {}, `${SIGNS[call.state]} ${call.action}`), el("span", { class: "soft" }, ` #${call.index}`)), definitions(rows)];
  const troubles = [...model.troubles.values()].filter((trouble) => `${trouble.run}/${trouble.call}` === key).map((trouble) => troubleOf(model, trouble, false));
  const attempts = [...model.requests.entries()].filter(([, request]) => `${request.run}/${request.call}` === key);
  const sent = el("table", { class: "attempts" },
    el("thead", {}, el("tr", {}, ...["", "sent", "accepted", "ended", "outcome"].map((text) => el("th", { scope: "col" }, text)))),
    el("tbody", {}, ...attempts.map(([id, request]) => attemptOf(model, id, request, when, isNow))));
  const list = (texts) => el("ul", {}, ...texts.map((text) => el("li", {}, text)));
  const blocks = [block("", ...about), ...troubles.map((trouble) => block("", trouble)), attempts.length ? block("Attempts", sent) : ""];
  if (detail) {
    blocks.push(block("Waits for", detail.waits_for.length ? waits(detail.waits_for, true) : el("p", { class: "soft" }, "nothing: it may start as soon as its conditions hold")));
    if (detail.checks.length) blocks.push(block("Conditions", checksOf(model, call, detail.checks, isNow)));
    if (detail.effects.length) blocks.push(block("Effects", list(detail.effects)));
    if (detail.needed_by.length) blocks.push(block("Needed by", waits(detail.needed_by, false)));
    if (detail.recoveries.length) blocks.push(block("Recoveries", list(detail.recoveries)));
    blocks.push(block("Where its token is", netOf(detail, call.state)), whyOf(model, key));
  }
  place.replaceChildren(...blocks.filter((each) => each !== ""));
}

// Why the call is in its plan, and why it began when it did or what it waits for: asked when somebody wants to know.
function whyOf(model, key) {
  const button = el("button", { type: "button", id: "why" }, "Why this call, why now?");
  button.addEventListener("click", async () => {
    const number = model.number;
    button.disabled = true;
    try {
      const answer = await fetch(`/why?call=${key}&at=${number}`);
      const told = await answer.json();
      why = { key, number, answers: answer.ok ? told : [{ statement: told.refused, known: "", reasons: [] }] };
    } catch {
      why = { key, number, answers: [{ statement: "the page is not there any more", known: "", reasons: [] }] };
    }
    const place = document.getElementById("why-block");
    if (place) place.replaceWith(whyOf(model, key));
  });
  const isAnswered = why?.key === key;
  return el("div", { class: "block", id: "why-block" }, button,
    isAnswered ? el("p", { class: "soft" }, `after record ${why.number}:`) : "", isAnswered ? reasons(why.answers) : "");
}

function block(title, ...content) {
  return el("div", { class: "block" }, title ? el("h3", {}, title) : "", ...content);
}

function attemptOf(model, id, request, when, isNow) {
  const name = stateOf(request, model.runs.get(request.run)?.is_over ?? true);
  const said = request.message || request.feedback;
  return el("tr", {}, el("td", {}, String(request.attempt)), el("td", { class: "num" }, when(request.sent)), el("td", { class: "num" }, when(request.accepted)),
    el("td", { class: "num" }, when(request.ended)), el("td", {}, `${SIGNS[name]} ${words(request.outcome || name)}`, said ? el("span", { class: "soft" }, ` ${said}`) : "", el("div", { class: "soft num" }, `request ${id.slice(-8)}`),
      isNow && name === "running" ? requestButtons(id, request) : ""));
}

// The limit that is running, with what is left of it; it runs down while nothing is recorded.
function limitOf(model, key, detail, isNow) {
  const isOpen = (request) => `${request.run}/${request.call}` === key && !request.outcome && !(model.runs.get(request.run)?.is_over ?? true);
  const request = [...model.requests.values()].find(isOpen);
  const limit = request?.accepted === null ? detail.accept : detail.limit;
  if (!request || !limit) return detail.limit ? `${seconds(detail.limit, 0)} from its acceptance` : "none";
  const text = el("span", { class: "num" });
  const bar = el("meter", { min: 0, max: limit, "aria-label": "used of the limit" });
  limits = { model, isNow, limit, from: request.accepted ?? request.sent, what: request.accepted === null ? "for its acceptance" : "to be done", text, bar };
  runDown();
  return el("span", { id: "limit" }, bar, " ", text);
}

function runDown() {
  for (const { model, isNow, since, text } of ages) text.textContent = `for ${seconds((isNow ? timeNow(model) : model.time) - since, 1)}`;
  if (!limits) return;
  const { model, isNow, limit, from, what, text, bar } = limits;
  const used = Math.min(limit, (isNow ? timeNow(model) : model.time) - from);
  text.textContent = `${seconds(used, 1)} of ${seconds(limit, 0)} ${what}; ${seconds(limit - used, 1)} left`;
  bar.value = used;
}

setInterval(runDown, 250);

function definitions(rows) {
  return el("dl", {}, ...rows.flatMap(([name, value]) => [el("dt", {}, name), el("dd", {}, value)]));
}

function waits(list, hasSigns) {
  return el("ul", {}, ...list.map((wait) => el("li", {}, hasSigns ? el("span", { class: "sign" }, wait.has_come ? "✓" : "○") : "",
    ` the ${wait.moment} of #${wait.call} ${wait.action}`, wait.protects.length ? el("span", { class: "soft" }, ` for ${wait.protects.join(" ")}`) : "")));
}

// The conditions, each with the facts that it reads: their values, how they are known, and for how long they have been so.
function checksOf(model, call, checks, isNow) {
  const sign = { true: "✓ true", false: "✕ false", unknown: "? unknown" };
  const isPast = (check) => check.when === "before it starts" && call.started !== null; // it has been looked at, and says nothing any more
  return el("table", { class: "checks" }, el("thead", {}, el("tr", {}, ...["when", "condition", "now"].map((text) => el("th", { scope: "col" }, text)))),
    el("tbody", {}, ...checks.map((check) => el("tr", { "data-truth": check.truth },
      el("td", { class: "soft" }, isPast(check) ? "before it started" : check.when),
      el("td", {}, check.text, el("ul", { class: "reads" }, ...readsOf(model, check, isNow))),
      el("td", { class: isPast(check) ? "num soft" : "num" }, isPast(check) ? `now ${check.truth}` : sign[check.truth])))));
}

function readsOf(model, check, isNow) {
  if (!check.reads.length) return [el("li", { class: "soft" }, `${check.source}; observed ${check.observed}`)];
  const only = check.reads.length === 1 && check.reads[0].name === check.text;
  const lines = check.reads.map((read) => {
    const age = el("span", { class: "age" }, read.is_initial ? "since the beginning" : "");
    if (!read.is_initial && read.since !== null) ages.push({ model, isNow, since: read.since, text: age });
    return el("li", { class: "soft", "data-fact": read.name }, only ? "" : `${read.name} `, el("span", { class: "value" }, only ? "" : `is ${read.value}, `),
      KNOWN[read.source] ?? read.source, read.is_initial || read.since !== null ? ", " : "", age);
  });
  if (check.others) lines.push(el("li", { class: "soft" }, `and ${check.others} more`));
  runDown();
  return lines;
}

const WAY = ["ready", "requested", "running", "finished", "done"];
const BELOW = { budget: 0, spent: 0.45, withdrawing: 1.05, recover: 1.75, overdue: 2.3, settling: 2.85, stopping: 3.4, suspending: 2.85, returned: 2.3, ended: 3.4, failed: 4 };

// The block of the call: its way from left to right, and below it what happens when something goes wrong.
function netOf(detail, state) {
  const at = new Map();
  let others = 0;
  const [stepX, first] = [104, 40];
  const used = new Set();
  for (const place of detail.places) {
    const name = place.name.replace(/^restarted /, "");
    const again = place.name !== name;
    if (WAY.includes(name)) at.set(place.name, [first + WAY.indexOf(name) * stepX + (again ? 24 : 0), again ? 62 : 26]);
    else {
      let x = first + (BELOW[name] ?? others++ * 0.6) * stepX;
      let y = again ? 150 : 104;
      while (used.has(`${Math.round(x / 44)} ${y}`)) y += 46;
      used.add(`${Math.round(x / 44)} ${y}`);
      at.set(place.name, [x, y]);
    }
  }
  const height = 34 + Math.max(26, ...[...at.values()].map(([, y]) => y));
  const arcs = new Map();
  for (const transition of detail.transitions) {
    for (const from of transition.inputs) for (const to of transition.outputs) {
      const key = `${from}>${to}`;
      const arc = arcs.get(key) ?? { from, to, names: [], open: false };
      arc.names.push(transition.name);
      arc.open ||= transition.is_enabled;
      arcs.set(key, arc);
    }
  }
  // its usual way, and what may come next: all arcs together would only be a tangle
  const isMarked = new Set(detail.places.filter((place) => place.tokens).map((place) => place.name));
  const isUsual = (arc) => WAY.includes(arc.from) && WAY.indexOf(arc.to) === WAY.indexOf(arc.from) + 1;
  const lines = [...arcs.values()].filter((arc) => arc.from !== arc.to && (isUsual(arc) || (isMarked.has(arc.from) && !/budget|spent/.test(arc.from)))).map((arc) => {
    const [[x1, y1], [x2, y2]] = [at.get(arc.from), at.get(arc.to)];
    const bend = y1 === y2 && Math.abs(x2 - x1) > stepX * 1.2 ? -26 : 0;
    return svg("path", { class: arc.open ? "open" : "", d: `M${x1} ${y1}Q${(x1 + x2) / 2} ${(y1 + y2) / 2 + bend} ${x2} ${y2}` }, svg("title", {}, arc.names.join(", ")));
  });
  const places = detail.places.map((place) => {
    const [x, y] = at.get(place.name);
    return svg("g", { class: place.tokens ? "marked" : "", "data-place": place.name }, svg("title", {}, `${place.name}: ${place.tokens}`), svg("circle", { cx: x, cy: y, r: 9 }),
      place.tokens === 1 ? svg("circle", { class: "token", cx: x, cy: y, r: 4 }) : place.tokens ? svg("text", { x, y: y + 4 }, String(place.tokens)) : "",
      svg("text", { x, y: y + 20 }, place.name));
  });
  const width = 2 * first + 4 * stepX;
  const marked = detail.places.filter((place) => place.tokens && !/budget|spent/.test(place.name)).map((place) => place.name);
  const opens = detail.transitions.filter((transition) => transition.is_enabled).map((transition) => transition.name);
  const elsewhere = state === "waiting" ? "it has not reached the block of this call yet" : "it has left the block: the call is over";
  const said = marked.length ? `marked: ${marked.join(", ")}` : elsewhere;
  return el("div", { id: "net" }, svg("svg", { viewBox: `0 0 ${width} ${height}`, width, height, role: "img", "aria-label": said }, ...lines, ...places),
    el("p", { class: "soft" }, said + (opens.length && marked.length ? `; next may fire: ${[...new Set(opens)].join(", ")}` : "")));
}
