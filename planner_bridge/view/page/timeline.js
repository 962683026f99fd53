// The timeline of a task: a lane for each robot, plan over actual, new plans as cuts, and a line where we are.
//
// What stays where it was is left alone. Bars that are too narrow to be seen one by one are one path: of a thousand, a frame changes a few.

import { callsOf, isOther, requestsOf, taskOf } from "./model.js";
import { actionOf, el, fitted, look, mark, span, stateOf, svg, tod, whole, widthOf } from "./words.js";

const TOP = 26, ROW = 25, PAD = 6, BAR = 20, NARROW = 5;
const $ = (id) => document.getElementById(id);
let zoom = null; // the part that is shown, from when to when; null for the whole task
let drawn = { layout: "", bars: new Map() };
let width = 0;

$("legend").append(...[["pl", "planned"], ["ac ok", "done"], ["ac run", "running"], ["ac bad", "failed"]].map(([looks, text]) => el("span", { class: "row" },
  svg("svg", { width: 14, height: 10 }, svg("rect", { class: looks, x: 0.5, y: 0.5, width: 13, height: 9, rx: 2 })), text)));

export const zoomed = () => Boolean(zoom);

export function zoomBy(factor, redraw, at = 0.5) {
  if (factor === 0 || !drawn.span) zoom = null;
  else {
    const [from, to] = zoom ?? drawn.span;
    const centre = from + (to - from) * at;
    const length = Math.max(1, (to - from) * factor);
    const start = centre - length * at;
    zoom = length >= drawn.span[1] - drawn.span[0] ? null : [Math.max(drawn.span[0], Math.min(start, drawn.span[1] - length)), 0];
    if (zoom) zoom[1] = zoom[0] + length;
  }
  redraw();
}

export function watchTimeline(redraw) {
  const place = $("lanes");
  new ResizeObserver(() => {
    width = place.clientWidth;
    redraw();
  }).observe(place);
  place.addEventListener("wheel", (wheel) => {
    if (!wheel.ctrlKey && !wheel.metaKey && !(zoom && wheel.shiftKey)) return;
    wheel.preventDefault();
    if (wheel.shiftKey) pan((wheel.deltaY || wheel.deltaX) / 400, redraw);
    else zoomBy(wheel.deltaY > 0 ? 1.25 : 0.8, redraw, Math.max(0, Math.min(1, (wheel.offsetX - drawn.left) / (width - drawn.left))));
  }, { passive: false });
  let held = null;
  place.addEventListener("pointerdown", (pointer) => (held = zoom ? pointer.clientX : null));
  addEventListener("pointermove", (pointer) => {
    if (held === null) return;
    pan((held - pointer.clientX) / Math.max(1, width - drawn.left), redraw);
    held = pointer.clientX;
  });
  addEventListener("pointerup", () => (held = null));
}

function pan(part, redraw) {
  if (!zoom) return;
  const length = zoom[1] - zoom[0];
  const from = Math.max(drawn.span[0], Math.min(zoom[0] + part * length, drawn.span[1] - length));
  zoom = [from, from + length];
  redraw();
}

let shownTask = "";

export function showTimeline(model, id, now, chosen, choose) {
  if (shownTask !== id) [shownTask, zoom] = [id, null];
  const task = model.tasks.get(id);
  const place = $("lanes");
  const runs = task ? task.runs.filter((run) => model.runs.has(run)) : [...model.runs.keys()].filter((run) => !taskOf(model, run));
  const isOpen = task ? task.state !== "over" : runs.some((run) => !model.runs.get(run).is_over);
  const end = isOpen ? now : task?.ended ?? model.time;
  const [bars, planned] = [barsOf(model, runs, end, chosen), plannedOf(model, runs)];
  $("timeline").hidden = !bars.length && !planned.length;
  if ($("timeline").hidden || !width) return;
  const began = Math.min(task?.time ?? Infinity, ...runs.map((run) => model.runs.get(run).time));
  const all = [began, spanEnd(began, Math.max(began + 1, ...bars.map((bar) => bar.to), ...planned.map((bar) => bar.to), ...bars.map((bar) => bar.rest ?? 0), isOpen ? now : 0))];
  const [from, to] = zoom ?? all;
  const lanes = lanesOf(bars, planned);
  const isSmall = width < 560;
  const left = isSmall ? 40 : Math.min(140, 44 + Math.max(24, ...[...lanes.keys()].map((name) => widthOf(name, true) + 8)));
  const layout = JSON.stringify([id, width, from, to, [...lanes].map(([name, lane]) => [name, lane.plan.length, lane.actual.length]), runs, planned.length, model.clock]);
  if (layout !== drawn.layout) layOut(model, { layout, left, from, to, all, began, lanes, planned, runs, isSmall, place, choose });
  drawn.span = all;
  drawBars(model, bars, choose);
  const x = drawn.x(now);
  const isSeen = isOpen && now >= from && now <= to;
  drawn.now.setAttribute("visibility", isSeen ? "visible" : "hidden");
  drawn.future.setAttribute("visibility", isSeen ? "visible" : "hidden");
  for (const each of drawn.names) placeName(each, isSeen ? x : -1);
  if (isSeen) {
    const text = `now ${span(now - began)}`;
    const box = widthOf(text, true) + 12;
    const at = Math.min(x - 1, width - box);
    drawn.now.children[0].setAttribute("d", `M${x} 20V${drawn.height}`);
    drawn.now.children[1].setAttribute("x", at);
    drawn.now.children[1].setAttribute("width", box);
    drawn.now.children[2].setAttribute("x", at + 6);
    drawn.now.children[2].textContent = text;
    drawn.future.setAttribute("x", x);
    drawn.future.setAttribute("width", Math.max(0, width - x));
  }
  drawn.svg.setAttribute("aria-label", `${bars.length} requests of ${lanes.size} robots in ${span(end - began)}`);
}

// A planned name stands whole in its bar, or not at all; it steps aside of the line of now.
function placeName(each, now) {
  const { label, name, a, b } = each;
  const wide = widthOf(name);
  const isHit = now > a + 3 && now < a + 9 + wide;
  const at = isHit ? now + 5 : a + 6;
  const looks = at + wide + 4 > b ? "" : String(at);
  if (each.at === looks) return;
  each.at = looks;
  label.setAttribute("x", at);
  label.textContent = looks ? name : "";
}

// The end of the scale, with some room, so that not every moment is another scale.
function spanEnd(began, end) {
  const length = (end - began) * 1.04;
  const unit = 10 ** Math.floor(Math.log10(length)) / 4;
  return began + Math.ceil(length / unit) * unit;
}

const over = new WeakMap(); // the bars of requests that are over, which stay as they are

function barsOf(model, runs, end, chosen) {
  const bars = [];
  for (const run of runs) {
    const isOver = model.runs.get(run).is_over;
    for (const [id, request] of requestsOf(model, run)) {
      const known = over.get(request);
      if (known && request.run === run) {
        known.isChosen = known.call === chosen;
        bars.push(known);
        continue;
      }
      const call = `${run}/${request.call}`;
      const state = stateOf(request, isOver);
      const duration = model.calls.get(call)?.duration ?? null;
      bars.push({ id, call, lane: request.lane, from: request.sent, to: request.ended ?? (isOver ? request.accepted ?? request.sent : end), state, attempt: request.attempt, isChosen: call === chosen,
        rest: state === "running" && duration !== null && request.sent + duration > end ? request.sent + duration : null, name: actionOf(request.action).name, action: request.action,
        words: request.declared || request.message || request.feedback || look(state)[2] });
      if (request.ended !== null) over.set(request, bars.at(-1));
    }
  }
  return bars.sort((a, b) => a.from - b.from);
}

// Planned bars, unless nobody planned times; of a plan that another one follows, only what was planned until then. What a plan has
// taken over from the one before stands there alone: it is not planned anew.
let schedule = { looks: "", bars: [] }; // those of before, which mostly stay as they are

function plannedOf(model, runs) {
  const own = runs.filter((run) => model.runs.get(run).is_own);
  const looks = JSON.stringify(runs.map((run) => [run, model.runs.get(run).origin, model.runs.get(run).time, callsOf(model, run).length]));
  if (schedule.looks === looks) return schedule.bars;
  const bars = [];
  for (const run of runs) {
    const { origin, time } = model.runs.get(run);
    const all = callsOf(model, run);
    if (origin === null || !all.some(([, call]) => call.planned > 0 || all.length === 1)) continue;
    const taken = new Set(requestsOf(model, run).filter(([, request]) => request.sent < time).map(([, request]) => request.call));
    const calls = all.filter(([, call]) => !taken.has(call.index));
    const late = Math.max(0, time - Math.min(...calls.map(([, call]) => origin + call.planned))); // what goes on with the rest of a plan
    const until = model.runs.get(own[own.indexOf(run) + 1])?.time ?? Infinity;
    for (const [key, call] of calls) {
      const from = origin + call.planned + late;
      const to = Math.min(from + (call.duration ?? 0), until);
      if (from < to) bars.push({ key, lane: call.lane, from, to, isCut: from + call.duration > until && call.state !== "handed_over", action: call.action, name: actionOf(call.action).name });
    }
  }
  schedule = { looks, bars: bars.sort((a, b) => a.from - b.from) };
  return schedule.bars;
}

// Bars of a lane that overlap stand below each other.
function lanesOf(bars, planned) {
  const lanes = new Map([...new Set([...bars, ...planned].map((bar) => bar.lane))].sort((a, b) => a.localeCompare(b, "en", { numeric: true })).map((name) => [name, { plan: [], actual: [] }]));
  const stack = (which) => (bar) => {
    const ends = lanes.get(bar.lane)[which];
    const free = ends.findIndex((end) => end <= bar.from + 1e-6);
    bar.row = free < 0 ? ends.length : free;
    ends[bar.row] = bar.to;
  };
  planned.forEach(stack("plan"));
  bars.forEach(stack("actual"));
  return lanes;
}

// Draws all but the actual bars.
function layOut(model, { layout, left, from, to, began, lanes, planned, runs, isSmall, place, choose }) {
  const x = (time) => Math.round((left + ((time - from) / (to - from)) * (width - left - 1)) * 10) / 10;
  const parts = [], tops = new Map(), names = [];
  let y = TOP;
  for (const [name, lane] of lanes) {
    const [plans, actual] = [lane.plan.length, Math.max(1, lane.actual.length)];
    const height = (plans + actual) * ROW + PAD;
    parts.push(svg("path", { class: "ax", d: `M0 ${y}H${width}` }),
      svg("text", { class: "tn", x: 0, y: y + (isSmall || !plans ? 18 : height / 2 + 4) }, fitted(name, left - (plans && !isSmall ? 44 : 4), true), svg("title", {}, name)));
    if (!isSmall && plans) parts.push(svg("text", { class: "td", x: left - 6, y: y + 20, "text-anchor": "end" }, "plan"), svg("text", { class: "td", x: left - 6, y: y + plans * ROW + 20, "text-anchor": "end" }, "actual"));
    tops.set(name, { plan: y + PAD, actual: y + PAD + plans * ROW });
    y += height;
  }
  const height = y;
  parts.push(svg("path", { class: "ax", d: `M0 ${height}H${width}` }));
  let narrow = "";
  for (const bar of planned) {
    const [a, b] = [Math.max(x(bar.from), left), Math.min(x(bar.to), width) - 1.5];
    if (b <= left || a >= width) continue;
    const top = tops.get(bar.lane).plan + bar.row * ROW;
    if (b - a < NARROW) {
      narrow += `M${a} ${top}h${Math.max(0.5, b - a)}v${BAR - 1}h${-Math.max(0.5, b - a)}z`;
      continue;
    }
    const label = svg("text", { class: "td", y: top + 14 });
    names.push({ label, name: bar.name, a, b, at: null });
    const group = svg("g", { class: "bar planned" }, svg("title", {}, `planned: ${bar.action}, ${tod(model, bar.from)} to ${tod(model, bar.to)}${bar.isCut ? ", cut by a new plan" : ""}`),
      svg("rect", { class: `pl ${bar.isCut ? "drop" : ""}`, x: a + 0.5, y: top + 0.5, width: Math.max(1, b - a - 1), height: BAR - 1, rx: 4 }), label);
    group.addEventListener("click", () => choose(bar.key));
    parts.push(group);
  }
  if (narrow) parts.push(svg("path", { class: "pl", d: narrow }));
  const grid = ticksOf(from, to, began, width - left, model.clock === null).flatMap((time) => {
    const at = x(time);
    const [day, since] = [tod(model, time), span(time - began)];
    const room = model.clock !== null && (width - left) / ((to - from) / stepOf) > 104;
    const anchor = at < left + 24 ? 0 : -22;
    if (at + anchor + widthOf(day) > width) return [svg("path", { class: "ax", d: `M${at} ${TOP}V${height + 5}` })];
    return [svg("path", { class: "ax", d: `M${at} ${TOP}V${height + 5}` }), svg("text", { x: at + anchor, y: height + 17 }, model.clock === null ? since : day),
      room && at + anchor + widthOf(day) + widthOf(since) + 6 < width ? svg("text", { class: "td", x: at + anchor + widthOf(day) + 6, y: height + 17 }, since) : ""].filter(Boolean);
  });
  const cuts = cutsOf(model, runs, x, left, height);
  const future = svg("rect", { class: "fut", y: TOP, height: height - TOP });
  const now = svg("g", { class: "now" }, svg("path", { class: "nowl" }), svg("rect", { class: "nowb", y: 0, height: 20, rx: 4 }), svg("text", { class: "t-on", y: 14 }));
  const group = svg("g");
  const picture = svg("svg", { class: "g", width, height: height + 20, viewBox: `0 0 ${width} ${height + 20}`, role: "img" }, future, ...grid, ...cuts, ...parts, group, now);
  drawn = { ...drawn, layout, x, left, tops, names, height, now, future, group, svg: picture, bars: new Map(), narrow: new Map() };
  place.replaceChildren(picture);
}

// New plans: a line from above the lanes, with a label that stands left of it, unless another one is there.
function cutsOf(model, runs, x, left, height) {
  const own = runs.filter((run) => model.runs.get(run).is_own);
  let taken = left;
  return own.flatMap((id) => {
    const run = model.runs.get(id);
    const at = x(run.time);
    if (!run.replan || at < left || at > width) return [];
    const name = isOther(run) ? "new plan" : "goes on";
    const long = `${name}: ${why(run.replan.why)}`;
    const text = isOther(run) && at - taken > widthOf(name, true) + 70 ? fitted(long, at - taken - 30, true) : name;
    const box = widthOf(text, true) + 26;
    const start = Math.max(0, at - box < taken ? Math.min(taken, width - box) : at - box);
    const label = [svg("rect", { class: "cutb", x: start, y: 0, width: box, height: 20, rx: 4 }), mark("cut", start + 5, 4, "cut"), svg("text", { class: "t-cut", x: start + 21, y: 14 }, text)];
    taken = start + box + 4;
    return [svg("g", { class: "newplan" }, svg("title", {}, `${tod(model, run.time)}: ${run.replan.why}`), svg("path", { class: "cutl", d: `M${at} 20V${height}` }), ...label)];
  });
}

// A reason for a new plan, from its first words on.
const why = (text) => text.replace(/^a new plan is needed: /, "").split(/[;:]/)[0];

function drawBars(model, bars, choose) {
  const seen = new Set(), paths = new Map();
  for (const bar of bars) {
    const ends = drawn.x(Math.max(bar.to, bar.rest ?? 0));
    if (ends < drawn.left - 1 || drawn.x(bar.from) >= width) continue;
    const a = Math.max(drawn.x(bar.from), drawn.left);
    const isRunning = bar.state === "running";
    const end = Math.min(drawn.x(bar.to), width);
    const b = Math.max(a + 1, isRunning ? Math.round(end) : end - 1.5); // one that runs grows by whole pixels
    const top = drawn.tops.get(bar.lane).actual + bar.row * ROW;
    const colour = look(bar.state)[1];
    if (b - a < NARROW && bar.rest === null && !bar.isChosen) {
      paths.set(colour, `${paths.get(colour) ?? ""}M${a} ${top}h${Math.max(1, b - a)}v${BAR}h${-Math.max(1, b - a)}z`);
      continue;
    }
    seen.add(bar.id);
    const old = drawn.bars.get(bar.id);
    const looks = `${a} ${isRunning && b - a > 14 ? bar.rest === null : b} ${top} ${bar.state} ${bar.isChosen} ${isRunning || bar.words} ${bar.rest}`;
    if (old?.looks === looks) {
      if (isRunning && old.b !== b) grown(old, bar, a, b);
      continue;
    }
    const group = barOf(model, bar, a, Math.max(2, b - a), top, colour);
    group.addEventListener("click", () => choose(bar.call));
    if (old) old.group.replaceWith(group);
    else drawn.group.append(group);
    drawn.bars.set(bar.id, { looks, group, b });
  }
  for (const [id, old] of drawn.bars) {
    if (seen.has(id)) continue;
    old.group.remove();
    drawn.bars.delete(id);
  }
  for (const colour of new Set([...paths.keys(), ...drawn.narrow.keys()])) {
    if (!drawn.narrow.has(colour)) {
      drawn.narrow.set(colour, svg("path", { class: `ac ${colour}` }));
      drawn.group.prepend(drawn.narrow.get(colour));
    }
    const d = paths.get(colour) ?? "";
    if (drawn.narrow.get(colour).getAttribute("d") !== d) drawn.narrow.get(colour).setAttribute("d", d);
  }
}

// Has the bar of a call that runs end where it is by now: its parts stay.
function grown(old, bar, a, b) {
  old.b = b;
  const of = (name) => old.group.querySelector(name);
  of(".ac").setAttribute("width", Math.max(1, b - a - 1));
  of("svg").setAttribute("x", a + (b - a) / 2 - 6);
  const [rest, text] = [of(".rest"), of(".t-run")];
  if (!rest) return;
  const room = Math.min(drawn.x(bar.rest), width) - b;
  rest.setAttribute("x", b - 2);
  rest.setAttribute("width", Math.max(2, room));
  text?.setAttribute("x", b + 7);
  if (text && widthOf(bar.name, true) > room - 10) text.remove();
}

function barOf(model, bar, x, wide, top, colour) {
  const [sign] = look(bar.state);
  const parts = [svg("title", {}, `${bar.action}, attempt ${bar.attempt}: ${bar.words}; ${tod(model, bar.from)}${bar.state === "running" ? "" : ` to ${tod(model, bar.to)}`}`)];
  if (bar.rest !== null) parts.push(svg("rect", { class: "pl rest", x: x + wide - 2, y: top + 0.5, width: Math.max(2, Math.min(drawn.x(bar.rest), width) - x - wide), height: BAR - 1, rx: 4 }));
  parts.push(svg("rect", { class: `ac ${colour} ${bar.state === "running" ? "glow" : ""}`, x: x + 0.5, y: top + 0.5, width: Math.max(1, wide - 1), height: BAR - 1, rx: Math.min(4, wide / 2) }));
  const on = colour === "ok" || colour === "dim" ? colour : `on-${colour}`;
  const text = colour === "ok" || colour === "dim" ? whole(bar.name, wide - 24) : "";
  if (wide > 14) parts.push(mark(sign, text ? x + 4 : x + wide / 2 - 6, top + 4, on));
  if (text) parts.push(svg("text", { class: "t-ok", x: x + 19, y: top + 14 }, text));
  if (bar.rest !== null) {
    const room = Math.min(drawn.x(bar.rest), width) - x - wide - 10;
    const rest = whole(bar.name, room - (wide > 14 ? 0 : 16), true);
    if (wide <= 14 && room > 16) parts.push(mark("run", x + wide + 5, top + 4, "run"));
    if (rest) parts.push(svg("text", { class: "t-run", x: x + wide + (wide > 14 ? 7 : 21), y: top + 14 }, rest));
  }
  return svg("g", { class: `bar${bar.isChosen ? " chosen" : ""}`, "data-state": bar.state, "data-call": bar.call }, ...parts);
}

let stepOf = 1;

function ticksOf(from, to, began, room, isRelative) {
  const most = Math.max(2, Math.floor(room / (isRelative ? 64 : 76)));
  stepOf = [1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1800, 3600, 7200, 21600].find((each) => (to - from) / each <= most) ?? 43200;
  const first = Math.ceil((from - began) / stepOf);
  return Array.from({ length: Math.floor((to - began) / stepOf) - first + 1 }, (_, number) => began + (first + number) * stepOf);
}

