// The timeline: a lane for each robot, with planned bars above actual ones, replans as cuts, and a line where we are.
//
// What stays where it was is left alone: of a thousand bars, a frame changes a few.

import { SIGNS, el, seconds, stateOf, svg } from "./words.js";

const ROW = 22, PLANNED = 7, GAP = 10, TOP = 42;

// What is drawn: for what it was laid out, where times and lanes are, and its bars with what they look like.
let drawn = { layout: "", bars: new Map() };
let sight = null; // how wide the place is, and how far it is scrolled: asked of the browser only when that has changed
let overBars = new WeakMap(); // of requests that are over, which stay as they are

function inSight(place) {
  if (!sight) {
    sight = { width: place.clientWidth, left: place.scrollLeft };
    new ResizeObserver(() => (sight.width = place.clientWidth)).observe(place);
    place.addEventListener("scroll", () => {
      sight.left = place.scrollLeft;
      followNames();
    });
  }
  return sight;
}

export function showTimeline(model, chosen, choose) {
  const place = document.getElementById("lanes");
  const bars = barsOf(model, chosen);
  const lanes = lanesOf(model, bars);
  const busiest = Math.max(1, ...[...lanes.values()].map((lane) => lane.count));
  const wide = inSight(place).width;
  const narrow = wide < 560;
  const left = narrow ? 6 : 92;
  const step = 2 ** Math.max(2, Math.floor(Math.log2(busiest)) - 2); // so that not every request is another layout
  const room = Math.ceil(busiest / step) * step;
  const width = Math.max(wide - 2, Math.min(30000, left + room * (narrow ? 34 : 26)));
  const planned = plannedOf(model);
  const end = scaleOf(model, [...bars, ...planned]);
  const layout = JSON.stringify([width, end, model.began, [...lanes].map(([name, lane]) => [name, lane.rows]), [...model.runs].map(([id, run]) => [id, run.origin, run.replan])]);
  if (layout !== drawn.layout) draw(place, model, { layout, width, left, narrow, end, lanes, planned });
  for (const [id, bar] of bars) drawBar(id, bar, choose);
  for (const [id, old] of drawn.bars) {
    if (!model.requests.has(id)) {
      old.group.remove();
      drawn.bars.delete(id);
    }
  }
  const now = drawn.x(model.time);
  drawn.now.setAttribute("x1", now);
  drawn.now.setAttribute("x2", now);
  drawn.svg.setAttribute("aria-label", `${bars.length} attempts of ${lanes.size} robots, until ${seconds(model.time - model.began)}`);
  if (drawn.seen !== model.time) keepInSight(place, now);
  drawn.seen = model.time;
}

// Draws all but the bars.
function draw(place, model, { layout, width, left, narrow, end, lanes, planned }) {
  const x = (time) => Math.round((left + ((time - model.began) / (end - model.began)) * (width - left - 14)) * 10) / 10;
  const parts = [];
  const names = svg("g", { class: "names" });
  const tops = new Map();
  let y = TOP;
  for (const [name, lane] of lanes) {
    const extra = narrow ? 15 : 0;
    parts.push(svg("line", { class: "lane", x1: 0, x2: width, y1: y - GAP / 2, y2: y - GAP / 2 }));
    names.append(svg("text", { class: "name", x: 4, y: y + (narrow ? 10 : PLANNED + 17) }, name.length > 12 && !narrow ? `${name.slice(0, 11)}…` : name));
    tops.set(name, y + extra);
    y += extra + PLANNED + 3 + lane.rows * ROW + GAP;
  }
  if (!lanes.size) parts.push(svg("text", { class: "soft", x: left + 8, y: TOP + 14 }, "nothing has begun yet"));
  for (const [, bar] of planned) {
    if (tops.has(bar.lane)) parts.push(svg("rect", { class: "planned", x: x(bar.from), y: tops.get(bar.lane), width: Math.max(2, x(bar.to) - x(bar.from)), height: PLANNED, rx: 2 }, svg("title", {}, `planned: ${bar.action}`)));
  }
  const height = Math.max(y, TOP + 20);
  const grid = ticksOf(end - model.began).map((tick) => svg("g", {},
    svg("line", { class: "grid", x1: x(model.began + tick), x2: x(model.began + tick), y1: TOP - 24, y2: height }),
    svg("text", { class: "soft", x: x(model.began + tick), y: 12, "text-anchor": tick ? "middle" : "start" }, `${tick} s`)));
  const cuts = [...model.runs.values()].filter((run) => run.replan).map((run, number) => svg("g", {},
    svg("title", {}, run.replan.why),
    svg("line", { class: "cut", x1: x(run.time), x2: x(run.time), y1: TOP - 6, y2: height }),
    svg("text", { class: "cut-text", x: x(run.time), y: TOP - 9, "text-anchor": "middle" }, `↻${number + 1}`)));
  const now = svg("line", { class: "now", y1: TOP - 24, y2: height });
  const group = svg("g");
  const picture = svg("svg", { width, height, viewBox: `0 0 ${width} ${height}`, role: "img" }, ...grid, ...parts, group, ...cuts, now, names);
  drawn = { layout, x, tops, names, now, group, svg: picture, bars: new Map(), seen: drawn.seen };
  place.replaceChildren(picture);
  followNames();
  showCuts(model);
}

function drawBar(id, bar, choose) {
  const old = drawn.bars.get(id);
  if (old?.bar === bar && old.row === bar.row && old.isChosen === bar.isChosen) return;
  const looks = `${bar.from} ${bar.to} ${bar.row} ${bar.state} ${bar.isChosen} ${bar.words} ${bar.declared}`;
  drawn.bars.set(id, { bar, row: bar.row, isChosen: bar.isChosen, looks, group: old?.group });
  if (old?.looks === looks) return;
  const [from, width] = [drawn.x(bar.from), Math.max(3, drawn.x(bar.to) - drawn.x(bar.from))];
  const y = drawn.tops.get(bar.lane) + PLANNED + 3 + bar.row * ROW;
  const text = `${SIGNS[bar.state]} ${bar.action}${bar.attempt > 1 ? ` (${bar.attempt})` : ""}${bar.declared ? `: ${bar.declared}` : ""}`;
  const letters = Math.floor((width - 8) / 6.1);
  const label = letters >= text.length ? text : letters > 6 ? `${text.slice(0, letters - 1)}…` : letters >= 1 ? text.slice(0, 1) : "";
  const group = svg("g", { class: `bar${bar.isChosen ? " chosen" : ""}`, "data-state": bar.state, "data-call": bar.call },
    svg("title", {}, `${bar.action}, attempt ${bar.attempt}: ${bar.words}`),
    svg("rect", { x: from, y, width, height: ROW - 3, rx: 3 }),
    label ? svg("text", { x: from + 4, y: y + 13.5 }, label) : "");
  group.addEventListener("click", () => choose(bar.call));
  if (old) old.group.replaceWith(group);
  else drawn.group.append(group);
  drawn.bars.get(id).group = group;
}

// Names of lanes stay where they can be read when the picture is scrolled.
function followNames() {
  drawn.names.setAttribute("transform", `translate(${sight.left} 0)`);
}

function keepInSight(place, now) {
  if (now <= sight.left + sight.width - 20 && now >= sight.left + Math.min(100, now)) return;
  place.scrollLeft = Math.max(0, now - 0.75 * sight.width);
  sight.left = place.scrollLeft;
  followNames();
}

// The end of the scale: while something goes on there is some room, so that not every moment is another scale.
function scaleOf(model, bars) {
  let end = Math.max(model.time, model.began + 1);
  for (const [, bar] of bars) end = Math.max(end, bar.to);
  const goesOn = [...model.tasks.values()].some((task) => task.state !== "over");
  if (!goesOn || end > model.time) return end;
  const span = end - model.began;
  const unit = 10 ** Math.floor(Math.log10(span)) / 2;
  return model.began + Math.ceil((span * 1.05) / unit) * unit;
}

function barsOf(model, chosen) {
  const bars = [...model.requests].map(([id, request]) => {
    const isOver = model.runs.get(request.run)?.is_over ?? true;
    const known = overBars.get(request);
    if (known) {
      known[1].isChosen = known[1].call === chosen;
      return known;
    }
    const call = `${request.run}/${request.call}`;
    const entry = [id, {
      lane: request.lane, from: request.sent, to: request.ended ?? (isOver ? request.accepted ?? request.sent : model.time), row: 0,
      state: stateOf(request, isOver), action: request.action, attempt: request.attempt, declared: request.declared, call, isChosen: call === chosen,
      words: request.outcome ? `${request.declared || request.outcome}${request.message ? `: ${request.message}` : ""}` : request.feedback || "is under way",
    }];
    if (request.outcome) overBars.set(request, entry);
    return entry;
  });
  return bars.sort(([, a], [, b]) => a.from - b.from);
}

// Planned bars, unless nobody planned times; of a run that another one follows, only what was planned until then.
function plannedOf(model) {
  const until = new Map();
  for (const task of model.tasks.values()) {
    task.runs.forEach((run, place) => until.set(run, model.runs.get(task.runs[place + 1])?.time ?? Infinity));
  }
  const timed = new Set();
  for (const call of model.calls.values()) if (call.planned > 0 || model.calls.size === 1) timed.add(call.run);
  const bars = [];
  for (const [key, call] of model.calls) {
    const run = model.runs.get(call.run);
    if (!run || run.origin === null || !timed.has(call.run)) continue;
    const from = run.origin + call.planned;
    const to = Math.min(from + (call.duration ?? 0), until.get(call.run) ?? Infinity);
    if (from <= to) bars.push([key, { lane: call.lane, from, to, action: call.action }]);
  }
  return bars;
}

// Bars of a lane that overlap stand below each other.
function lanesOf(model, bars) {
  const names = new Set();
  for (const call of model.calls.values()) names.add(call.lane);
  for (const [, bar] of bars) names.add(bar.lane);
  const lanes = new Map([...names].sort().map((name) => [name, { rows: 1, count: 0, ends: [] }]));
  for (const [, bar] of bars) {
    const lane = lanes.get(bar.lane);
    const free = lane.ends.findIndex((end) => end <= bar.from + 1e-6);
    bar.row = free < 0 ? lane.ends.length : free;
    lane.ends[bar.row] = bar.to;
    lane.rows = Math.max(lane.rows, lane.ends.length);
    lane.count += 1;
  }
  return lanes;
}

function ticksOf(span) {
  const step = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1800, 3600, 7200, 21600].find((each) => span / each <= 9) ?? 43200;
  return Array.from({ length: Math.floor(span / step) + 1 }, (_, number) => Number((number * step).toFixed(2)));
}

function showCuts(model) {
  const runs = [...model.runs.values()].filter((run) => run.replan);
  const part = (sign, word, calls) => (calls.length ? el("span", { class: "what" }, `${sign} ${word}: ${calls.join(", ")}`) : "");
  document.getElementById("cuts").replaceChildren(...runs.map((run, number) => el("li", {},
    el("strong", {}, `↻${number + 1} `), el("span", { class: "num" }, `${seconds(run.time - model.began)} `), run.replan.why,
    part("=", "kept", run.replan.kept), part("−", "dropped", run.replan.dropped), part("+", "added", run.replan.added))));
}
