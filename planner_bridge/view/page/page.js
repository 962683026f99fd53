// The page: a model that the stream keeps, or one from the past; what is chosen; and what is drawn of it, once for all that has come.

import { showInspector, tick } from "./call.js";
import { closeGoal, hasControls, hasNode, isHeld, openControls, openGoal, say, showControls, taskDoes } from "./controls.js";
import { askDay, hourOf, showDay, showDock, showStarts, watchLists } from "./lists.js";
import { PARTS, applied, callsOf, eventsOf, nothing, requestsOf, taskOf, timeNow, titleOf, wayOf } from "./model.js";
import { showPlan, showPolicy, watchPlan } from "./plan.js";
import { ordered, questionsOf, showHead, showLeft, showNeeds } from "./tasks.js";
import { showTimeline, watchTimeline, zoomBy } from "./timeline.js";
import { MARKS, el, icon, keyed, mark, svg, tod } from "./words.js";

const $ = (id) => document.getElementById(id);

let live = nothing();
let past = null;
let isConnected = false;
let refused = ""; // why this page is not told what happens
let detail = null;
let dirty = new Set();
let asked = null;
let wanted = null; // the time that is asked for, until it is there
const ui = { task: "", pinned: false, run: "", sel: null, tab: "events", day: null };

const shown = () => past ?? live;
const nowOf = (model) => (past ? model.time : timeNow(model));

// --- what happens now ---

function connect() {
  const source = new EventSource(`/events${live.journal ? `?of=${live.journal}&after=${live.number}` : ""}`);
  source.addEventListener("open", () => {
    refused = "";
    connected(true);
  });
  source.addEventListener("error", async () => {
    if (source.readyState === EventSource.CLOSED) {
      refused = await whyRefused(source.url);
      setTimeout(connect, refused ? 10000 : 2000);
    }
    connected(false);
  });
  source.addEventListener("message", (message) => {
    const frame = JSON.parse(message.data);
    if (frame.journal !== live.journal && live.journal) past = null;
    const [model, parts] = applied(live, frame);
    live = model;
    draw(past ? ["way"] : [...parts, "way", "time"]);
  });
}

// The reason why nothing more is told to this page, which no event has.
async function whyRefused(url) {
  const asking = new AbortController();
  try {
    const answer = await fetch(url, { signal: asking.signal });
    return answer.ok ? "" : (await answer.json()).refused;
  } catch {
    return "";
  } finally {
    asking.abort();
  }
}

function connected(isSo) {
  isConnected = isSo;
  draw(["way"]);
}

// --- what has happened ---

// Shows what was so after a record, or by a time.
async function go({ number, time }) {
  asked?.abort();
  asked = new AbortController();
  const mine = asked;
  wanted = { number: number ?? null, time };
  $("way").value = time;
  try {
    const answer = await fetch(number ? `/state?at=${number}` : `/state?time=${time.toFixed(6)}`, { signal: mine.signal });
    const frame = await answer.json();
    if (!answer.ok) throw new Error(frame.refused);
    [past] = applied(nothing(), frame);
    if (asked === mine) wanted = null;
    draw("all");
  } catch (error) {
    if (error.name === "AbortError") return;
    wanted = null;
    said("bad", error.message);
  }
}

function goLive() {
  asked?.abort();
  past = wanted = null;
  draw("all");
}

// The moments to step through: marks have records of their own, else all that happened at a time is one moment.
function stopsOf(onlyMarks) {
  const marks = [...live.events].filter(([, event]) => event.mark).map(([number, event]) => ({ number: Number(number), time: event.time }));
  const times = onlyMarks ? [] : [...new Set(eventsOf(live).map((event) => event.time))].map((time) => ({ number: null, time }));
  return [...marks, ...times].sort((a, b) => a.time - b.time || (a.number ?? Infinity) - (b.number ?? Infinity));
}

function step(by, onlyMarks = false) {
  const here = wanted ?? (past ? { number: past.at ?? past.number, time: past.time } : { number: Infinity, time: Infinity });
  const isBefore = (stop) => stop.time < here.time || (stop.time === here.time && stop.number !== null && here.number !== null && stop.number < here.number);
  const isAfter = (stop) => stop.time > here.time || (stop.time === here.time && stop.number !== null && here.number !== null && stop.number > here.number);
  const stops = stopsOf(onlyMarks);
  const found = by < 0 ? stops.filter(isBefore).pop() : stops.find(isAfter);
  if (found) go(found);
  else if (by > 0 && past) goLive();
}

// --- what is chosen ---

function chosenTask(model) {
  if (ui.pinned && model.tasks.has(ui.task)) return ui.task;
  const tasks = ordered(model);
  const asks = questionsOf(model).find(([, question]) => model.tasks.has(question.task))?.[1].task;
  const open = tasks.filter(([, task]) => task.state !== "over");
  const going = open.find(([, task]) => task.runs.length) ?? open[0];
  return asks ?? going?.[0] ?? tasks.filter(([, task]) => task.state === "over").sort(([, a], [, b]) => b.ended - a.ended)[0]?.[0] ?? "";
}

function chosenRun(model, id) {
  const task = model.tasks.get(id);
  const runs = task?.runs.filter((run) => model.runs.has(run)) ?? [...model.runs.keys()];
  if (runs.includes(ui.run)) return ui.run;
  const own = runs.filter((run) => model.runs.get(run).is_own);
  return (own.length ? own : runs).at(-1) ?? "";
}

const WORTH = ["running", "failed", "suspended", "waiting"];

// What the inspector shows: what was chosen, else the call that is most worth a look, else the task.
function selected(model, id, run) {
  if (ui.sel && (ui.sel.kind !== "call" || model.calls.has(ui.sel.key))) return ui.sel;
  const task = model.tasks.get(id);
  if (task && (task.state === "over" || !run)) return { kind: "task", key: id };
  let [best, rank] = ["", WORTH.length];
  for (const [key, call] of callsOf(model, run)) {
    const own = WORTH.indexOf(call.state);
    if (own >= 0 && own < rank) [best, rank] = [key, own];
    if (!rank) break;
  }
  return best ? { kind: "call", key: best } : task ? { kind: "task", key: id } : null;
}

function choose(what) {
  if (what.kind === "day") ui.day = { back: what.back, hour: what.hour };
  else if (what.kind === "task") chooseTask(what.key, true);
  else {
    ui.sel = what;
    const model = shown();
    if (what.kind === "call") {
      const run = what.key.split("/")[0];
      const id = taskOf(model, run);
      if (id) Object.assign(ui, { task: id, pinned: true, day: null });
      ui.run = what.within ?? run; // a call that a plan has dropped is shown beside that plan
    }
  }
  draw("all");
}

function chooseTask(id, isShown = false) {
  Object.assign(ui, { task: id, pinned: true, run: "", sel: isShown ? { kind: "task", key: id } : null, day: null });
  draw("all");
}

// --- drawing: once for all that has come since the last time ---

function draw(parts) {
  const isFirst = dirty.size === 0;
  for (const part of parts === "all" ? [...PARTS, "way", "time", "all"] : parts) dirty.add(part);
  if (isFirst && dirty.size) requestAnimationFrame(drawn);
}

function drawn() {
  const model = shown();
  const isNow = !past;
  const now = nowOf(model);
  const has = (...parts) => parts.some((part) => dirty.has(part) || dirty.has("all"));
  ui.task = chosenTask(model);
  const run = chosenRun(model, ui.task);
  const what = selected(model, ui.task, run);
  const call = what?.kind === "call" ? what.key : "";
  const open = [...model.tasks.values()].filter((task) => task.state !== "over");
  if (has("tasks", "calls", "runs", "questions", "hands", "facts", "time")) {
    showLeft(model, ui, now, chooseTask, choose);
    if (!ui.day) showHead(model, ui.task, now, isNow, choose);
  }
  if (has("questions", "tasks")) showNeeds(model, isNow);
  if (has("requests", "calls", "runs", "tasks", "time") && !ui.day) showTimeline(model, ui.task, now, call, (key) => choose({ kind: "call", key }));
  if (has("runs", "tasks", "calls") && !ui.day) {
    showPlan(model, run, callsOf(model, run), call, (key, within) => choose(model.calls.has(key) ? { kind: "call", key, within } : { kind: "task", key: ui.task }), () => draw(["calls"]));
    showPolicy(model, run, ui.task ? wayOf(model, ui.task, model.tasks.get(ui.task)) : []);
  }
  if (has("calls", "requests", "troubles", "runs", "tasks", "hands", "questions")) showChosen(model, what, isNow);
  if (has("events", "requests", "tasks", "runs", "questions", "facts", "servers", "hands")) showDock(model, ui, isNow, choose);
  if (has("tasks")) showStarts(model, !open.length && !ui.day, isNow);
  if (ui.day && has("tasks", "time")) askDay(live, () => draw("all"));
  for (const id of ["task", ...(ui.day ? ["timeline", "plan", "policy"] : [])]) $(id).hidden = Boolean(ui.day);
  showDay(model, ui, ui.day ? Math.max(240, ($("mid").clientWidth || innerWidth) - 32) : 0, choose);
  if (has("way", "events", "time")) showWay(model);
  showControls(isNow, open.some(isHeld));
  const asks = questionsOf(live).length;
  const running = [...live.tasks.values()].filter((task) => task.state !== "over").length;
  document.title = `${asks ? `(${asks}) ` : ""}${live.name || "pnm"} · ${running ? `${running} running` : "idle"}`;
  dirty = new Set();
}

let looked = []; // what the inspector was made of
let asking = false;
let again = false;
let told = ""; // the text of the detail, which is mostly the same as before

function showChosen(model, what, isNow) {
  if (ui.day) {
    $("detail").replaceChildren(...hourOf(model, ui, choose));
    looked = [];
    return;
  }
  const [run, index] = what?.kind === "call" ? what.key.split("/") : [];
  const about = what?.kind === "call" && `${detail?.run}/${detail?.index}` === what.key ? detail : null;
  const mine = run ? [...requestsOf(model, run).filter(([, one]) => one.call === Number(index)).map(([, one]) => one), ...[...model.troubles.values()].filter((one) => one.run === run && one.call === Number(index)), model.calls.get(what.key), model.runs.get(run)]
    : what?.kind === "task" ? [model.number] : what?.kind === "robot" ? [model.number] : [model.facts.get(what?.key)];
  const looks = [past, hasControls(), what?.kind, what?.key, about, ...mine];
  if (looks.length !== looked.length || looks.some((each, place) => each !== looked[place])) showInspector(model, what, about, isNow, choose);
  looked = looks;
  if (run) askDetail(what.key);
}

// Asks for the detail of the call that is shown: one request at a time, and once more if something has changed meanwhile.
async function askDetail(key) {
  again = asking;
  if (asking) return;
  const model = shown();
  asking = true;
  try {
    const answer = await fetch(`/call?call=${key}&at=${model.number}`);
    if (answer.ok) {
      const text = await answer.text();
      if (text !== told || `${detail?.run}/${detail?.index}` !== key) {
        [told, detail] = [text, JSON.parse(text)];
        draw(["calls"]);
      }
    }
  } catch {
    // the stream says that the server is not there
  } finally {
    asking = false;
    if (again) setTimeout(() => draw(["calls"]), Math.max(250, 10 * model.watching)); // the more there are who ask, the less often
  }
}

// --- time ---

function said(colour, text) {
  const looks = `${colour} ${text}`;
  if ($("status").dataset.looks === looks) return;
  $("status").dataset.looks = looks;
  $("status").title = text;
  $("status").replaceChildren(colour === "ok" ? el("i", { class: "dot" }) : icon(colour === "bad" ? "bad" : "back", colour), el("span", { class: "el" }, text));
}

let troubled = ""; // the problem that was said last

function showWay(model) {
  const way = $("way");
  const end = Math.max(live.began + 1, [...live.tasks.values()].some((task) => task.state !== "over") ? timeNow(live) : live.time);
  way.min = live.began;
  way.max = end;
  way.value = wanted ? wanted.time : past ? model.time : end;
  way.disabled = !live.number;
  const at = tod(model, past ? model.time : nowOf(model));
  way.setAttribute("aria-valuetext", at);
  $("where").textContent = past ? tod(live.clock === null ? model : live, model.time) : model.number ? tod(model, nowOf(model)) : "";
  $("live").setAttribute("aria-pressed", String(!past));
  document.body.classList.toggle("past", Boolean(past));
  document.body.dataset.record = model.number;
  $("back").disabled = !live.number;
  $("forward").disabled = $("to-mark-after").disabled = !past;
  $("node").textContent = live.name || "Petri Net Machines";
  $("host").textContent = live.host ? `on ${live.host}` : "";
  showMarks(end);
  const problem = model.problem || live.problem;
  if (problem && problem !== troubled) say(problem, true);
  troubled = problem;
  if (problem) said("bad", "cannot be read on");
  else if (!isConnected) said("bad", refused || "not connected");
  else if (past) said("run", "history");
  else said("ok", "live");
}

let marksWidth = 0;
new ResizeObserver(([{ contentRect }]) => {
  marksWidth = Math.round(contentRect.width);
  draw(["way"]);
}).observe($("marks"));

const URGENT = ["failure", "replan", "end"];

function showMarks(end) {
  const place = $("marks");
  const width = marksWidth || 600;
  const x = (time) => Math.round((width * (time - live.began)) / Math.max(1e-9, end - live.began));
  const marks = [];
  for (const [number, event] of [...live.events].filter(([, one]) => one.mark).sort(([, a], [, b]) => a.time - b.time)) {
    const last = marks.at(-1);
    if (last && x(event.time) - last.x < 20) {
      last.all.push(event.mark);
      if (URGENT.indexOf(event.mark) < URGENT.indexOf(last.kind)) Object.assign(last, { kind: event.mark, number: Number(number), time: event.time });
    } else marks.push({ x: x(event.time), kind: event.mark, number: Number(number), time: event.time, all: [event.mark] });
  }
  const entries = marks.map((each) => [`${each.number}`, `${each.x} ${each.kind} ${each.all.length}`, { "data-mark": each.kind, "data-record": each.number, "data-count": each.all.length }, () => {
    const [sign, word] = MARKS[each.kind];
    const same = each.all.filter((kind) => kind === each.kind).length;
    return [svg("title", {}, `${tod(live, each.time)}: ${word}${each.all.length > 1 ? ` and ${each.all.length - 1} more` : ""}`), svg("rect", { x: each.x - 8, y: 0, width: 20, height: 26, fill: "none", "pointer-events": "all" }), mark(sign, each.x - 6, 8, sign),
      svg("path", { d: `M${each.x} 23v4`, class: sign, stroke: "currentColor", "stroke-width": 1.5 }), same > 1 ? svg("text", { class: "td", x: each.x + 7, y: 18 }, String(same)) : ""];
  }]);
  const value = x(wanted ? wanted.time : past ? past.time : end);
  const step = [1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 14400].find((each) => (end - live.began) / each <= width / 110) ?? 43200;
  const offset = live.clock === null ? 0 : step - ((live.clock + live.began) % step);
  const ticks = Array.from({ length: Math.max(0, Math.floor((end - live.began - offset) / step) + 1) }, (_, at) => live.began + offset + at * step).filter((time) => x(time) < width - 52);
  const looks = JSON.stringify([width, value, entries.map(([key, each]) => [key, each]), ticks.map(x), live.clock]);
  if (place.dataset.looks === looks) return;
  place.dataset.looks = looks;
  place.replaceChildren(svg("rect", { class: "ax fut", x: 0, y: 28, width, height: 4, rx: 2 }), svg("rect", { class: "nowb", x: 0, y: 28, width: Math.max(0, value), height: 4, rx: 2 }),
    ...ticks.flatMap((time) => [svg("path", { class: "ax", d: `M${x(time) + 0.5} 34v4` }), svg("text", { class: "td", x: x(time) + 4, y: 45 }, tod(live, time, step < 60))]),
    ...entries.map(([, , attributes, children]) => {
      const group = svg("g", attributes, ...children());
      group.addEventListener("click", () => go({ number: attributes["data-record"], time: live.events.get(String(attributes["data-record"])).time }));
      return group;
    }));
}

// --- people ---

$("way").addEventListener("input", () => go({ time: Number($("way").value) }));
$("way").addEventListener("keydown", (key) => {
  if (!["ArrowLeft", "ArrowRight"].includes(key.key)) return;
  key.preventDefault();
  step(key.key === "ArrowLeft" ? -1 : 1, key.shiftKey);
});
$("back").addEventListener("click", () => step(-1));
$("forward").addEventListener("click", () => step(1));
$("to-mark-before").addEventListener("click", () => step(-1, true));
$("to-mark-after").addEventListener("click", () => step(1, true));
$("live").addEventListener("click", goLive);
$("day-open").addEventListener("click", () => choose({ kind: "day", back: 0 }));
$("zoom-out").addEventListener("click", () => zoomBy(1.6, () => draw(["time"])));
$("zoom-in").addEventListener("click", () => zoomBy(0.625, () => draw(["time"])));
$("zoom-all").addEventListener("click", () => zoomBy(0, () => draw(["time"])));
$("help").addEventListener("click", () => $("keys").showModal());
$("theme").addEventListener("click", turnTheme);
$("grab").addEventListener("click", () => $("grab").setAttribute("aria-expanded", String($("insp").classList.toggle("up"))));
for (const tab of ["events", "facts", "servers"]) $(`tab-${tab}`).addEventListener("click", () => chooseTab(tab));
document.querySelector(".tabs").addEventListener("keydown", (key) => {
  const tabs = ["events", "facts", "servers"];
  if (key.target.role !== "tab" || !["ArrowLeft", "ArrowRight"].includes(key.key)) return;
  key.stopPropagation();
  chooseTab(tabs[(tabs.indexOf(ui.tab) + (key.key === "ArrowRight" ? 1 : 2)) % 3]);
  $(`tab-${ui.tab}`).focus();
});

function chooseTab(tab) {
  ui.tab = tab;
  draw(["facts"]);
}

function turnTheme() {
  const root = document.documentElement;
  const isDark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  root.dataset.theme = isDark ? "light" : "dark";
  localStorage.setItem("pnm-theme", root.dataset.theme);
}

const theme = localStorage.getItem("pnm-theme");
if (theme) document.documentElement.dataset.theme = theme;

function nextTask(by) {
  const ids = [...document.querySelectorAll("#task-list [data-task], #over [data-task]")].map((each) => each.dataset.task);
  const next = ids[Math.max(0, Math.min(ids.length - 1, ids.indexOf(ui.task) + by))];
  if (next) chooseTask(next);
}

function nextCall(by) {
  const model = shown();
  const calls = ui.task ? wayOf(model, ui.task, model.tasks.get(ui.task)).map(([key]) => key) : [];
  const what = selected(model, ui.task, chosenRun(model, ui.task));
  const next = calls[Math.max(0, Math.min(calls.length - 1, calls.indexOf(what?.key) + by))];
  if (next) choose({ kind: "call", key: next });
}

function ofTask(does) {
  const task = live.tasks.get(ui.task);
  if (past || !hasControls() || !task || task.state === "over") return;
  if (does === "pause") taskDoes[isHeld(task) ? "resume" : "pause"](ui.task, titleOf(task));
  else if (does !== "step" || task.state === "paused") taskDoes[does](ui.task, titleOf(task));
  else say("only a task that is paused makes a step", true);
}

function answered(key) {
  const found = document.querySelector(`#needs [data-answer="${CSS.escape(key)}"]`);
  found?.click();
  return Boolean(found);
}

// The keys, with what they do in words: the help is made of it.
const KEYS = [
  ["g", "type a goal", () => hasNode() && !past && openGoal()], ["j", "the next task", () => nextTask(1)], ["k", "the task before", () => nextTask(-1)],
  ["l", "the next call", () => nextCall(1)], ["h", "the call before", () => nextCall(-1)], ["Enter", "to the inspector", () => $("insp").focus()],
  ["y", "answer yes", () => answered("y")], ["n", "answer no", () => answered("n")], ["1–9", "answer by its number; without a question: events, knowledge, servers", null],
  ["p", "pause the task, or let it go on", () => ofTask("pause")], [".", "one step of a paused task", () => ofTask("step")], ["x", "cancel the task; asks first", () => ofTask("cancel")], ["P", "pause all", () => hasNode() && !past && $("pause-all").click()],
  ["ArrowLeft", "the event before; with Shift the mark before", (key) => step(-1, key.shiftKey)], ["ArrowRight", "the next event; with Shift the next mark", (key) => step(1, key.shiftKey)], ["End", "live", goLive],
  ["+", "zoom in", () => $("zoom-in").click()], ["-", "zoom out", () => $("zoom-out").click()], ["0", "the whole task", () => $("zoom-all").click()],
  ["t", "light or dark", turnTheme], ["Escape", "back", () => { closeGoal(); Object.assign(ui, { sel: null, day: null }); draw("all"); }], ["?", "these keys", () => $("keys").showModal()],
];
const SIGNS = { ArrowLeft: "←", ArrowRight: "→", Escape: "Esc", "-": "−", P: "Shift P" };
$("key-list").append(...KEYS.flatMap(([key, text]) => [el("dt", {}, el("kbd", {}, SIGNS[key] ?? key)), el("dd", {}, text)]));

addEventListener("keydown", (key) => {
  if (key.altKey || key.ctrlKey || key.metaKey || $("keys").open) return;
  if (key.key === "Escape" && key.target.closest("#goal-form, #goal-box")) document.activeElement.blur();
  else if (key.target.closest("input, select, textarea")) return;
  if (/^[1-9]$/.test(key.key)) {
    if (!answered(key.key) && !questionsOf(shown()).length) chooseTab(["events", "facts", "servers"][Number(key.key) - 1] ?? ui.tab);
    return;
  }
  if (key.key === "Enter" && key.target !== document.body && key.target.id !== "mid") return;
  const found = KEYS.find(([name, , act]) => name === key.key && act);
  if (!found) return;
  if (["g", "ArrowLeft", "ArrowRight", "End"].includes(key.key)) key.preventDefault();
  found[2](key);
});

watchTimeline(() => draw(["time"]));
watchPlan(() => draw(["calls"]));
watchLists(() => draw(["facts"]));
addEventListener("resize", () => draw("all"));
setInterval(() => {
  if (past || document.hidden) return;
  tick();
  const isOpen = [...live.tasks.values()].some((task) => task.state !== "over");
  if (isOpen || Math.floor(performance.now() / 1000) % 5 === 0) draw(["time"]);
}, 500);

connect();
openControls(() => draw("all"));
