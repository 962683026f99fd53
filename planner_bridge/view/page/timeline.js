// The timeline: a lane for each robot, with planned bars above actual ones, replans as cuts, and a line where we are.

import { SIGNS, el, seconds, stateOf, svg } from "./words.js";

const ROW = 22, PLANNED = 7, GAP = 10, TOP = 30;

export function showTimeline(model, chosen, choose) {
  const place = document.getElementById("lanes");
  const bars = barsOf(model);
  const end = Math.max(model.time, ...bars.map((bar) => bar.to), ...plannedOf(model).map((bar) => bar.to), model.began + 1);
  const narrow = place.clientWidth < 560;
  const left = narrow ? 6 : 92;
  const lanes = lanesOf(model, bars);
  const busiest = Math.max(1, ...[...lanes.values()].map((lane) => lane.bars.length));
  const width = Math.max(place.clientWidth - 2, Math.min(30000, left + busiest * (narrow ? 34 : 26)));
  const x = (time) => left + ((time - model.began) / (end - model.began)) * (width - left - 14);
  const parts = [];
  let y = TOP;
  for (const [name, lane] of lanes) {
    const extra = narrow ? 15 : 0;
    const height = extra + PLANNED + 3 + lane.rows * ROW + GAP;
    parts.push(svg("line", { class: "lane", x1: 0, x2: width, y1: y - GAP / 2, y2: y - GAP / 2 }));
    parts.push(svg("text", { class: "name", x: 4, y: y + (narrow ? 10 : PLANNED + 17) }, name.length > 12 && !narrow ? `${name.slice(0, 11)}…` : name));
    lane.top = y + extra;
    y += height;
  }
  for (const bar of plannedOf(model)) {
    const lane = lanes.get(bar.lane);
    if (lane) parts.push(svg("rect", { class: "planned", x: x(bar.from), y: lane.top, width: Math.max(2, x(bar.to) - x(bar.from)), height: PLANNED, rx: 2 }, svg("title", {}, `planned: ${bar.action}`)));
  }
  for (const bar of bars) parts.push(drawn(bar, lanes.get(bar.lane).top + PLANNED + 3, x, chosen, choose));
  const height = Math.max(y, TOP + 20);
  const grid = ticksOf(end - model.began).map((tick) => svg("g", {},
    svg("line", { class: "grid", x1: x(model.began + tick), x2: x(model.began + tick), y1: TOP - 8, y2: height }),
    svg("text", { class: "soft", x: x(model.began + tick), y: 12, "text-anchor": tick ? "middle" : "start" }, `${tick} s`)));
  const cuts = [...model.runs.values()].filter((run) => run.cut).map((run, number) => svg("g", {},
    svg("title", {}, run.cut.why),
    svg("line", { class: "cut", x1: x(run.time), x2: x(run.time), y1: TOP - 6, y2: height }),
    svg("text", { class: "cut-text", x: x(run.time), y: TOP - 7, "text-anchor": "middle" }, `↻${number + 1}`)));
  const now = [svg("line", { class: "now", x1: x(model.time), x2: x(model.time), y1: TOP - 14, y2: height })];
  place.replaceChildren(svg("svg", { width, height, viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": `${bars.length} attempts of ${lanes.size} robots, until ${seconds(model.time - model.began)}` }, ...grid, ...parts, ...cuts, ...now));
  showCuts(model);
}

function drawn(bar, top, x, chosen, choose) {
  const [from, width] = [x(bar.from), Math.max(3, x(bar.to) - x(bar.from))];
  const y = top + bar.row * ROW;
  const text = `${SIGNS[bar.state]} ${bar.action}${bar.attempt > 1 ? ` (${bar.attempt})` : ""}`;
  const letters = Math.floor((width - 8) / 6.1);
  const label = letters >= text.length ? text : letters > 6 ? `${text.slice(0, letters - 1)}…` : letters >= 1 ? text.slice(0, 1) : "";
  const group = svg("g", { class: `bar${chosen === bar.call ? " chosen" : ""}`, "data-state": bar.state, "data-call": bar.call },
    svg("title", {}, `${bar.action}, attempt ${bar.attempt}: ${bar.words}`),
    svg("rect", { x: from, y, width, height: ROW - 3, rx: 3 }),
    label ? svg("text", { x: from + 4, y: y + 13.5 }, label) : "");
  group.addEventListener("click", () => choose(bar.call));
  return group;
}

function barsOf(model) {
  return [...model.requests.values()].map((request) => {
    const isOver = model.runs.get(request.run)?.is_over ?? true;
    const to = request.ended ?? (isOver ? request.accepted ?? request.sent : model.time);
    const state = stateOf(request, isOver);
    const ending = request.outcome ? `${request.outcome}${request.message ? `: ${request.message}` : ""}` : request.feedback || "is under way";
    return { lane: request.lane, from: request.sent, to, state, action: request.action, attempt: request.attempt, call: `${request.run}/${request.call}`, words: ending };
  }).sort((a, b) => a.from - b.from);
}

// Planned bars: of a run that another one follows, only what was planned until then.
function plannedOf(model) {
  const until = new Map();
  for (const task of model.tasks.values()) {
    task.runs.forEach((run, place) => until.set(run, model.runs.get(task.runs[place + 1])?.time ?? Infinity));
  }
  return [...model.calls.values()].flatMap((call) => {
    const run = model.runs.get(call.run);
    if (!run || run.origin === null) return [];
    const from = run.origin + call.planned;
    const to = Math.min(from + (call.duration ?? 0), until.get(call.run) ?? Infinity);
    return from > to ? [] : [{ lane: call.lane, from, to, action: call.action }];
  });
}

// Bars of a lane that overlap stand below each other.
function lanesOf(model, bars) {
  const lanes = new Map();
  const names = new Set([...model.calls.values()].map((call) => call.lane).concat(bars.map((bar) => bar.lane)));
  for (const name of [...names].sort()) lanes.set(name, { rows: 1, bars: [], ends: [] });
  for (const bar of bars) {
    const lane = lanes.get(bar.lane);
    const free = lane.ends.findIndex((end) => end <= bar.from + 1e-6);
    bar.row = free < 0 ? lane.ends.length : free;
    lane.ends[bar.row] = bar.to;
    lane.rows = Math.max(lane.rows, lane.ends.length);
    lane.bars.push(bar);
  }
  return lanes;
}

function ticksOf(span) {
  const step = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1800, 3600, 7200, 21600].find((each) => span / each <= 9) ?? 43200;
  return Array.from({ length: Math.floor(span / step) + 1 }, (_, number) => Number((number * step).toFixed(2)));
}

function showCuts(model) {
  const runs = [...model.runs.values()].filter((run) => run.cut);
  const part = (sign, word, calls) => (calls.length ? el("span", { class: "what" }, `${sign} ${word}: ${calls.join(", ")}`) : "");
  document.getElementById("cuts").replaceChildren(...runs.map((run, number) => el("li", {},
    el("strong", {}, `↻${number + 1} `), el("span", { class: "num" }, `${seconds(run.time - model.began)} `), run.cut.why,
    part("=", "kept", run.cut.kept), part("−", "dropped", run.cut.dropped), part("+", "added", run.cut.added))));
}
