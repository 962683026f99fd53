// The inspector: all about what is chosen, a call, a robot, a fact, an event or a task; the net of a call behind a switch.

import { askButton, hasControls, requestButtons, robotCommands } from "./controls.js";
import { callsOf, doneOf, eventsOf, expectedEnd, isOther, requestsOf, robotsOf, taskOf, taskState, timeNow, titleOf, wayOf } from "./model.js";
import { robotWords } from "./tasks.js";
import { KNOWN, actionOf, button, el, figure, icon, inWords, keepingFocus, look, reasons, seconds, span, statePill, stateOf, svg, tod, words } from "./words.js";

const $ = (id) => document.getElementById(id);
let ticking = []; // the texts that go on while nothing is recorded: [element, what it says]
let why = null; // the last answer to the question why, with the call and the moment that it is about
let isNetOpen = false;
let isMoreOpen = false;

// Shows what is chosen: {kind, key}; what can be done about it, if that is now.
export function showInspector(model, chosen, detail, isNow, choose) {
  ticking = [];
  const make = { call: callOf, robot: robotOf, fact: factOf, event: eventOf, task: taskOfId }[chosen?.kind];
  const parts = (make && make(model, chosen.key, isNow, detail, choose)) || [section("", el("p", { class: "dim" }, "Choose a task, a robot, a call or a fact to see all about it."))];
  keepingFocus(() => $("detail").replaceChildren(...parts.filter(Boolean)));
  tick();
}

export function tick() {
  for (const [element, say] of ticking) {
    const text = say();
    if (element.textContent !== text) element.textContent = text;
  }
}

function ticks(name, attributes, say) {
  const element = el(name, attributes);
  ticking.push([element, say]);
  return element;
}

const section = (title, ...content) => el("section", {}, title ? el("h3", {}, title) : "", ...content);
const definitions = (rows) => el("dl", {}, ...rows.flatMap(([name, value]) => [el("dt", {}, name), el("dd", {}, value)]));

function headOf(sign, colour, title, pill, sub) {
  return section("", el("div", { class: "row" }, icon(sign, colour), el("h2", { class: "ti" }, title), el("span", { class: "sp" }), pill), el("p", { class: "sub" }, sub));
}

// --- a call ---

function callOf(model, key, isNow, detail, choose) {
  const call = model.calls.get(key);
  if (!call) return null;
  const { name, objects } = actionOf(call.action, call.lane);
  const [sign, colour] = look(call.state);
  const isOver = model.runs.get(call.run)?.is_over ?? true;
  const sent = requestsOf(model, call.run).filter(([, request]) => request.call === call.index).sort(([, a], [, b]) => a.sent - b.sent);
  const now = () => (isNow ? timeNow(model) : model.time);
  const head = headOf(sign, colour, name, statePill(call.state), [call.lane, ...objects].filter((each) => each !== call.action.split("(")[0]).join(" · ") || call.action);
  head.append(stepsOf(model, call, sent.at(-1)?.[1], now));
  if (call.outcome && !["waiting", "running", "succeeded", call.state].includes(call.outcome)) head.append(el("p", { class: "reason" }, words(call.outcome)));
  const parts = [head];
  const open = sent.find(([, request]) => stateOf(request, isOver) === "running");
  if (open || detail?.limit) parts.push(limitOf(model, call, open?.[1], detail, now));
  parts.push(...[...model.troubles.values()].filter((trouble) => `${trouble.run}/${trouble.call}` === key).map((trouble) => troubleOf(model, trouble, true)));
  if (detail?.checks.length) parts.push(section("Conditions", ...detail.checks.flatMap((check) => checkOf(model, call, check, now))));
  if (sent.length) parts.push(section("Attempts", ...sent.map(([id, request]) => attemptOf(model, id, request, isOver, isNow))));
  if (!detail) return parts;
  if (call.state === "waiting" && detail.waits_for.length) parts.push(section("Waits for", waits(detail.waits_for, choose, call.run)));
  parts.push(section("", whyOf(model, key)));
  const more = [];
  const plannedAt = model.runs.get(call.run)?.origin;
  more.push(definitions([["planned", [plannedAt === null || plannedAt === undefined ? "" : tod(model, plannedAt + call.planned), call.duration === null ? "" : `for ${span(call.duration)}`].filter(Boolean).join(" ") || "without a time"],
    ...(detail.server ? [["server", el("span", { class: "mono" }, detail.server)]] : []), ...detail.resources.map(([resource, holder]) => ["resource", holder ? `${resource}: ${holder} has it` : `${resource}: free`]),
    ...(call.is_assumed ? [["effects", "◌ some are believed: nothing reports them"]] : [])]));
  const list = (title, texts) => (texts.length ? [el("h3", {}, title), el("ul", {}, ...texts.map((text) => el("li", {}, text)))] : []);
  if (call.state !== "waiting" && detail.waits_for.length) more.push(el("h3", {}, "Waited for"), waits(detail.waits_for, choose, call.run));
  if (detail.needed_by.length) more.push(el("h3", {}, "Needed by"), waits(detail.needed_by, choose, call.run));
  more.push(...list("Effects", detail.effects.map((effect) => effect.replace(/\([^()]*\)$/, inWords))), ...list("Recoveries", detail.recoveries));
  parts.push(section("", folded("More of this call", isMoreOpen, (is) => (isMoreOpen = is), ...more)));
  parts.push(section("", folded("Its net", isNetOpen, (is) => (isNetOpen = is), netOf(detail, call.state))));
  return parts;
}

function folded(title, isOpen, turned, ...content) {
  const made = el("details", {}, el("summary", {}, title), ...content);
  made.open = isOpen;
  made.addEventListener("toggle", () => turned(made.open));
  return made;
}

const STEPS = ["waiting", "sent", "running", "checked", "done"];

function stepsOf(model, call, request, now) {
  const isBad = call.state === "failed", isDone = ["succeeded", "already_true"].includes(call.state);
  const isSent = Boolean(request), isAccepted = request?.accepted !== null && isSent, isEnded = request?.ended !== null && isSent;
  const at = isDone ? 5 : !isSent || call.state === "waiting" ? 0 : isBad && request.outcome !== "succeeded" ? 2 : isEnded ? 3 : isAccepted ? 2 : 1;
  const times = [call.started, request?.sent ?? null, request?.accepted ?? null, request?.ended ?? null, call.ended];
  const isLive = ["running", "suspended"].includes(call.state);
  return el("ol", { class: "steps" }, ...STEPS.map((name, place) => {
    const how = place < at ? "d" : place > at ? "" : isBad ? "x" : isLive ? "n" : "";
    const since = times[place];
    const time = place === at && isLive && since !== null ? ticks("small", {}, () => span(now() - since)) : el("small", {}, (place < at || (isBad && place === at)) && since !== null && (place < 4 || isDone) ? tod(model, since) : "\u00a0");
    return el("li", { class: how, "aria-current": place === at ? "step" : null }, icon(place < at ? "ok" : place === at && isBad ? "bad" : place === at && isLive ? "run" : ""), name, time);
  }));
}

// The limit that is running, with what is left of it, and when the end is expected.
function limitOf(model, call, request, detail, now) {
  const limit = request?.accepted === null ? detail?.accept : detail?.limit;
  if (!request || !limit) return request ? null : section("Limit", el("p", { class: "dim" }, `${span(detail.limit)} from its acceptance`));
  const from = request.accepted ?? request.sent;
  const used = el("i"), expected = el("u");
  const bar = el("div", { class: "limit", role: "meter", "aria-label": "used of the limit", "aria-valuemin": 0, "aria-valuemax": limit }, used, call.duration !== null && call.duration < limit ? expected : "");
  expected.style.left = `${(100 * (call.duration ?? 0)) / limit}%`;
  const say = () => {
    const gone = Math.min(limit, now() - from);
    used.style.width = `${(100 * gone) / limit}%`;
    bar.setAttribute("aria-valuenow", gone.toFixed(1));
    return `${seconds(gone)} of ${seconds(limit)} ${request.accepted === null ? "for its acceptance" : "to be done"}${call.duration === null ? "" : `, expected ${span(call.duration)}`}`;
  };
  return el("section", { id: "limit" }, el("h3", {}, "Limit"), ticks("small", {}, say), bar, request.feedback ? el("small", { class: "dim" }, request.feedback) : "");
}

// What a call was hindered by, or has failed with, and what followed.
export function troubleOf(model, trouble, isAlone) {
  const step = actionOf(trouble.step);
  const title = `${isAlone ? "" : `${step.name} ${step.objects.join(" ")} `}${trouble.is_failure ? "failed" : "hindered"} at ${tod(model, trouble.time)}`;
  return el("section", { class: "trouble", "data-cause": trouble.cause }, el("h3", {}, title.slice(0, 1).toUpperCase() + title.slice(1)),
    definitions([["expected", el("span", { class: "expected" }, trouble.expected || "–")],
      ["observed", el("span", {}, el("b", { class: "bad" }, `${words(trouble.cause)}${trouble.observed ? ": " : ""}`), el("span", { class: "bad observed" }, trouble.observed))], ["then", trouble.followed || "its plan goes on until it is decided"]]));
}

const TRUTH = { true: ["ok", "ok"], false: ["bad", "bad"], unknown: ["ask", "ask"] };

// A condition with what it is now, when it must hold, and how that is known; of a composed one its facts.
function checkOf(model, call, check, now) {
  const isPast = check.when === "before it starts" && call.started !== null; // it has been looked at, and says nothing any more
  const isToCome = ["when it ends", "once it is done"].includes(check.when) && call.ended === null;
  const when = isPast ? "before it started" : check.when;
  const age = (read) => (read.is_initial ? el("small", { class: "age" }, "since the start") : read.since === null ? el("small") : ticks("small", { class: "age" }, () => `${span(now() - read.since)} ago`));
  const reads = check.reads.length === 1 && check.reads[0].name === check.text ? [] : check.reads;
  const only = check.reads.length === 1 ? check.reads[0] : null;
  const [sign, colour] = isPast ? ["wait", "dim"] : check.truth === "false" && isToCome ? ["wait", "dim"] : TRUTH[check.truth];
  const value = check.truth === "false" && isToCome ? "not yet" : only && !["true", "false"].includes(only.value) ? figure(only.value) : isPast ? `now ${check.truth}` : check.truth;
  const source = KNOWN[only?.source ?? check.source] ?? only?.source ?? check.source;
  return [el("div", { class: "cd", "data-truth": check.truth, "data-fact": only?.name ?? null, title: check.text }, icon(sign, colour), el("span", {}, inWords(check.text)), isPast ? el("span", { class: "dim value" }, value) : el("b", {}, value),
    el("small", {}, `${when} · ${source}`), only ? age(only) : el("small")),
  ...(only ? [] : reads.map((read) => el("div", { class: "cd", "data-fact": read.name }, el("span"), el("small", {}, `${inWords(read.name)}: ${KNOWN[read.source] ?? read.source}`), el("small", {}, figure(read.value))))),
  ...(check.others ? [el("small", { class: "dim" }, `and ${check.others} more facts`)] : [])];
}

function attemptOf(model, id, request, isOver, isNow) {
  const state = stateOf(request, isOver);
  const [sign, colour, word] = look(state);
  const said = request.message || (request.outcome && request.outcome !== "succeeded" ? words(request.outcome) : request.declared);
  return el("div", { class: "attempt" }, icon(sign, colour), el("span", {}, `${request.attempt}. ${state === "running" ? `since ${tod(model, request.sent)}` : `${word}, ${tod(model, request.sent)} to ${request.ended === null ? "?" : tod(model, request.ended)}`}`),
    el("span", { class: "sp" }), el("span", { class: "mono dim", title: `request ${id}` }, id.slice(-8)), said ? el("small", { class: colour }, said) : "", isNow && state === "running" ? requestButtons(id, request) : "");
}

function waits(list, choose, run) {
  return el("ul", {}, ...list.map((wait) => el("li", {}, button(`${wait.has_come ? "✓" : "○"} ${wait.action}`, `the ${wait.moment} of #${wait.call}`, () => choose({ kind: "call", key: `${run}/${wait.call}` }), "link"),
    el("small", { class: "dim" }, ` ${wait.moment}${wait.protects.length ? `: ${wait.protects.map(inWords).join(", ")}` : ""}`))));
}

// Why the call is in its plan, and why it began when it did or what it waits for: asked when somebody wants to know.
function whyOf(model, key) {
  const ask = async (click) => {
    const [number, time] = [model.number, model.time];
    click.currentTarget.disabled = true;
    try {
      const answer = await fetch(`/why?call=${key}&at=${number}`);
      const told = await answer.json();
      why = { key, time, answers: answer.ok ? told : [{ statement: told.refused, known: "", reasons: [] }] };
    } catch {
      why = { key, time, answers: [{ statement: "the page is not there any more", known: "", reasons: [] }] };
    }
    document.getElementById("why-block")?.replaceWith(whyOf(model, key));
  };
  const isAnswered = why?.key === key;
  const made = button("Why this call, why now?", "asks the journal", ask);
  return el("div", { id: "why-block" }, made, isAnswered ? el("p", { class: "reason" }, `as of ${tod(model, why.time)}:`) : "", isAnswered ? reasons(why.answers) : "");
}

// --- what else can be chosen ---

function robotOf(model, name, isNow, _, choose) {
  const robot = robotsOf(model).find((each) => each.name === name) ?? (model.hands.has(name) ? { name, hand: model.hands.get(name).words } : { name });
  const now = () => (isNow ? timeNow(model) : model.time);
  const [sign, colour, first, second] = robotWords(model, robot, now());
  const link = (entry) => button(entry.call.action, titleOf(model.tasks.get(entry.task)), () => choose({ kind: "call", key: entry.key }), "link");
  const rows = [...(robot.now ? [["now", link(robot.now)]] : []), ...(robot.next ? [["next", link(robot.next)]] : []), ...(robot.last ? [["before", link(robot.last)]] : []),
    ...(robot.battery !== null && robot.battery !== undefined ? [["battery", `${Math.round(100 * robot.battery)} %`]] : [])];
  const facts = [...model.facts].filter(([fact, { value }]) => value !== "false" && new RegExp(`[ (]${name.replace(/[^\w-]/g, "\\$&")}[ )]`).test(fact)).slice(0, 12);
  return [headOf(sign, colour, name, el("span"), robot.hand || [first.filter(Boolean).join(" "), second].filter(Boolean).join("; ")), rows.length ? section("", definitions(rows)) : null,
    facts.length ? section("What is known of it", ...facts.map(([fact, about]) => factLine(model, fact, about, now))) : null, hasControls() && isNow ? robotCommands(name, model.hands.has(name)) : null];
}

function factLine(model, name, fact, now) {
  return el("div", { class: "cd", "data-fact": name, title: name }, icon(fact.value === "unknown" ? "ask" : "ok", fact.value === "unknown" ? "ask" : "ok"), el("span", {}, inWords(name)), el("b", {}, figure(fact.value)),
    el("small", {}, KNOWN[fact.source]), fact.is_initial ? el("small", {}, "since the start") : ticks("small", {}, () => `${span(now() - fact.since)} ago`));
}

function factOf(model, name, isNow) {
  const fact = model.facts.get(name);
  if (!fact) return null;
  const isStale = fact.source === "sensed" && fact.value === "unknown";
  const users = [...model.calls].filter(([, call]) => call.state === "running" && name.slice(1, -1).split(" ").slice(1).includes(call.lane)).slice(0, 6);
  return [headOf(fact.value === "false" ? "bad" : fact.value === "unknown" ? "ask" : "ok", fact.value === "true" ? "ok" : fact.value === "unknown" ? "ask" : "dim", inWords(name), el("span"), ""),
    section("", el("p", { class: "mono" }, name)), section("", definitions([["value", `${figure(fact.value)}${fact.was ? ` (was ${fact.was})` : ""}`], ["known by", isStale ? "◍ a sensor that says nothing any more" : KNOWN[fact.source]],
      ["since", fact.is_initial ? "the start" : tod(model, fact.since)]])), users.length ? section("Calls that run now with it", el("ul", {}, ...users.map(([, call]) => el("li", {}, call.action)))) : null];
}

function eventOf(model, id, isNow, _, choose) {
  const event = eventsOf(model).find((each) => each.id === id);
  if (!event) return null;
  return [headOf(event.sign, event.colour, event.name, el("small", { class: "dim" }, tod(model, event.time)), event.text),
    event.key || event.task ? section("", event.key ? button("The call", "all about the call", () => choose({ kind: "call", key: event.key })) : "", event.task ? button("The task", "all about the task", () => choose({ kind: "task", key: event.task })) : "") : null];
}

function taskOfId(model, id, isNow) {
  const task = model.tasks.get(id);
  if (!task) return null;
  const state = taskState(model, id, task);
  const [sign, colour] = look(state);
  const own = task.runs.filter((run) => model.runs.get(run)?.is_own);
  const way = wayOf(model, id, task);
  const troubles = [...model.troubles.values()].filter((trouble) => taskOf(model, trouble.run) === id).sort((a, b) => b.time - a.time);
  const end = task.ended ?? (isNow ? timeNow(model) : model.time);
  const expected = task.state === "over" ? null : expectedEnd(model, id, task, end);
  const changes = own.map((run) => model.runs.get(run)).filter((run) => run.replan);
  const calls = own.flatMap((run) => callsOf(model, run));
  const row = (sign, text, list) => (list.length ? [[`${sign} ${text}`, list.join(", ")]] : []);
  return [headOf(sign, colour, titleOf(task), statePill(state), task.reason || ""),
    section("In numbers", definitions([["time", `${span(end - task.time)}${expected === null ? "" : `, ${span(expected - end)} to go`}`], ["accepted", tod(model, task.time)], ...(task.ended === null ? [] : [["ended", tod(model, task.ended)]]),
      ["calls", `${doneOf(way)} of ${way.length} done`], ...(task.counts ? [["counts", task.counts]] : []), ...(task.limit === null ? [] : [["limit", `${span(task.used)} of ${span(task.limit)} used`]]),
      ...(task.odds?.words ? [["odds", `${task.odds.words}, ${task.odds.rests_on}`]] : []), ...(calls.length && task.title ? [["goal", el("span", { class: "mono" }, task.title)]] : [])])),
    ...changes.reverse().map((run) => section(`${isOther(run) ? "New plan" : "Goes on"} at ${tod(model, run.time)}`, el("p", {}, run.replan.why), definitions([...row("=", "kept", run.replan.kept), ...row("−", "dropped", run.replan.dropped), ...row("+", "added", run.replan.added)]))),
    ...troubles.slice(0, 20).map((trouble) => troubleOf(model, trouble, false)), isNow && task.title && state !== "goal_reached" ? askButton(id, task) : null];
}

// --- the net of a call ---

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
    el("p", { class: "dim" }, said + (opens.length && marked.length ? `; next may fire: ${[...new Set(opens)].join(", ")}` : "")));
}
