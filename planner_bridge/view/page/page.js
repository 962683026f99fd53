// The page: a model that the stream keeps, or one from the past; and what is drawn of it.

import { showCall } from "./call.js";
import { hasControls, openControls } from "./controls.js";
import { showEvents, showFacts, showServers } from "./lists.js";
import { PARTS, applied, nothing } from "./model.js";
import { showPlan, showPolicy, showStates } from "./plan.js";
import { showTasks } from "./tasks.js";
import { showTimeline } from "./timeline.js";
import { MARKS, el, seconds, svg } from "./words.js";

const $ = (id) => document.getElementById(id);

let live = nothing();
let past = null;
let isConnected = false;
let chosenRun = "";
let chosenCall = "";
let detail = null;
let dirty = new Set();
let asked = null;
let wanted = null; // the record that is asked for, until it is there

const shown = () => past ?? live;
const here = () => wanted ?? shown().number; // where the next step begins: keys come faster than answers

// --- what happens now ---

function connect() {
  const source = new EventSource(`/events${live.journal ? `?of=${live.journal}&after=${live.number}` : ""}`);
  source.addEventListener("open", () => connected(true));
  source.addEventListener("error", () => {
    connected(false);
    if (source.readyState === EventSource.CLOSED) setTimeout(connect, 2000);
  });
  source.addEventListener("message", (message) => {
    const frame = JSON.parse(message.data);
    if (frame.journal !== live.journal && live.journal) past = null;
    const [model, parts] = applied(live, frame);
    live = model;
    draw(past ? ["way"] : [...parts, "way", "time"]);
  });
}

function connected(isSo) {
  isConnected = isSo;
  draw(["way"]);
}

// --- what has happened ---

async function go(number) {
  asked?.abort();
  asked = new AbortController();
  const mine = asked;
  wanted = number;
  $("way").value = number;
  try {
    const answer = await fetch(`/state?at=${number}`, { signal: mine.signal });
    const frame = await answer.json();
    if (!answer.ok) throw new Error(frame.refused);
    [past] = applied(nothing(), frame);
    if (asked === mine) wanted = null;
    draw("all");
  } catch (error) {
    if (error.name === "AbortError") return;
    wanted = null;
    said(`✕ ${error.message}`, true);
  }
}

function goLive() {
  asked?.abort();
  past = wanted = null;
  draw("all");
}

function step(by) {
  const next = Math.max(1, Math.min(here() + by, live.number));
  if (next !== here()) go(next);
}

function toMark(by) {
  const marks = [...live.events].filter(([, event]) => event.mark).map(([number]) => Number(number)).sort((a, b) => a - b);
  const found = by < 0 ? marks.filter((number) => number < here()).pop() : marks.find((number) => number > here());
  if (found !== undefined) go(found);
}

// --- what is chosen ---

function newestRun(model) {
  const tasks = [...model.tasks.values()].filter((task) => task.runs.length);
  const open = tasks.filter((task) => task.state !== "over").sort((a, b) => b.priority - a.priority || a.order - b.order);
  const task = open[0] ?? tasks.sort((a, b) => b.order - a.order)[0];
  return task?.runs.at(-1) ?? [...model.runs.keys()].at(-1) ?? "";
}

const currentRun = (model) => (model.runs.has(chosenRun) ? chosenRun : newestRun(model));

const WORTH = ["failed", "running", "suspended", "waiting"];

// The call that people have chosen, or else the one that is most worth a look.
function currentCall(model) {
  if (model.calls.has(chosenCall)) return chosenCall;
  const run = currentRun(model);
  let [found, rank] = ["", WORTH.length + 1];
  for (const [key, call] of model.calls) {
    if (call.run !== run) continue;
    const place = WORTH.indexOf(call.state);
    if (place < 0 && rank >= WORTH.length) [found, rank] = [key, WORTH.length]; // the last one
    if (place >= 0 && place < rank) [found, rank] = [key, place];
    if (rank === 0) break;
  }
  return found;
}

function choose(key) {
  chosenCall = key;
  if (key) chosenRun = key.split("/")[0];
  draw(["calls", "runs"]);
}

// --- drawing: once for all that has come since the last time ---

function draw(parts) {
  const isFirst = dirty.size === 0;
  for (const part of parts === "all" ? [...PARTS, "way", "time"] : parts) dirty.add(part);
  if (isFirst && dirty.size) requestAnimationFrame(drawn);
}

function drawn() {
  const model = shown();
  const has = (...parts) => parts.some((part) => dirty.has(part));
  const run = currentRun(model);
  const call = currentCall(model);
  if (has("tasks", "troubles", "questions", "hands", "runs")) showTasks(model, !past);
  if (has("requests", "calls", "runs", "tasks", "time")) showTimeline(model, call, choose);
  if (has("runs", "tasks")) showRunChoice(model, run);
  if (has("runs", "tasks", "calls")) {
    showCallChoice(model, run, call);
    showPlan(model, run, choose).then(() => showStates(shown(), currentRun(shown()), currentCall(shown())));
    showPolicy(model, run);
  }
  if (has("calls", "requests", "troubles", "runs", "time")) {
    const about = `${detail?.run}/${detail?.index}` === call ? detail : null;
    if (isOther(model, call, about)) showCall(model, call, about, !past);
    askDetail();
  }
  if (has("facts")) showFacts(model);
  if (has("servers")) showServers(model);
  if (has("events")) showEvents(model, go);
  if (has("way", "events", "time")) showWay(model);
  dirty = new Set();
}

let asking = false;
let again = false;
let told = ""; // the text of the detail, which is mostly the same as before
let looked = []; // what the call that is shown was made of

// Returns whether there is anything new to be shown of a call.
function isOther(model, key, about) {
  const [run, number] = key.split("/");
  const own = (things) => [...things.values()].filter((thing) => thing.call === Number(number) && thing.run === run);
  const looks = [model, past, hasControls(), key, model.calls.get(key), about, model.runs.get(run), ...own(model.requests), ...own(model.troubles)];
  const is = looks.length !== looked.length || looks.some((each, place) => each !== looked[place]);
  looked = looks;
  return is;
}

// Asks for the detail of the call that is shown: one request at a time, and once more if something has changed meanwhile.
async function askDetail() {
  again = asking;
  if (asking) return;
  const model = shown();
  const key = currentCall(model);
  if (!key) return;
  asking = true;
  try {
    const answer = await fetch(`/call?call=${key}&at=${model.number}`);
    if (answer.ok) {
      const text = await answer.text();
      if (text !== told || `${detail?.run}/${detail?.index}` !== key) {
        [told, detail] = [text, JSON.parse(text)];
        if (currentCall(shown()) === key) draw(["calls"]);
      }
    }
  } catch {
    // the stream says that the server is not there
  } finally {
    asking = false;
    if (again) setTimeout(askDetail, 250);
  }
}

function showRunChoice(model, run) {
  const choice = $("run-choice");
  const options = [...model.tasks.values()].flatMap((task) => task.runs.map((id, place) => [id, `${task.goal}: run ${place + 1} of ${task.runs.length}`]));
  const listed = new Set(options.map(([id]) => id));
  for (const [id, each] of model.runs) if (!listed.has(id)) options.push([id, each.name]);
  fill(choice, [["", "the newest"], ...options], model.runs.has(chosenRun) ? run : "");
}

let offered = new Map(); // the calls to choose from, each with its option

function showCallChoice(model, run, chosen) {
  const calls = [...model.calls.entries()].filter(([, each]) => each.run === run);
  const text = (call) => `#${call.index} ${call.action}: ${call.outcome}`;
  if (calls.length !== offered.size || calls.some(([key]) => !offered.has(key))) {
    calls.sort(([, a], [, b]) => a.index - b.index);
    offered = new Map(calls.map(([key, call]) => [key, { call, option: el("option", { value: key }, text(call)) }]));
    $("call-choice").replaceChildren(...[...offered.values()].map((each) => each.option));
  }
  for (const [key, call] of calls) {
    const each = offered.get(key);
    if (each.call === call) continue;
    each.call = call;
    each.option.text = text(call);
  }
  if ($("call-choice").value !== chosen) $("call-choice").value = chosen;
}

function fill(choice, options, value) {
  const old = choice.options;
  if (old.length !== options.length || options.some(([key], place) => old[place].value !== key)) {
    choice.replaceChildren(...options.map(([key, text]) => el("option", { value: key }, text)));
  } else {
    options.forEach(([, text], place) => {
      if (old[place].text !== text) old[place].text = text;
    });
  }
  if (choice.value !== value) choice.value = value;
}

function said(text, isBad = false) {
  $("status").textContent = text;
  $("status").classList.toggle("bad", isBad);
}

function showWay(model) {
  const way = $("way");
  const [first, last] = [Math.max(1, Math.min(model.first || 1, live.first || 1)), Math.max(live.number, 1)];
  way.min = first;
  way.max = last;
  way.value = model.number;
  way.disabled = !live.number;
  way.setAttribute("aria-valuetext", `record ${model.number}, ${seconds(model.time - model.began)}`);
  $("where").textContent = `record ${model.number} of ${live.number} · ${seconds(model.time - model.began)}`;
  $("live").setAttribute("aria-pressed", String(!past));
  document.body.classList.toggle("past", Boolean(past));
  document.body.dataset.record = model.number;
  $("back").disabled = model.number <= 1;
  $("forward").disabled = model.number >= live.number;
  showMarks(first, last);
  const problem = model.problem || live.problem;
  if (problem) said(`✕ ${problem}`, true);
  else if (!isConnected) said("✕ not connected: the page shows what it knew; it tries again", true);
  else said(past ? `history, after record ${model.number}` : "● live");
}

function showMarks(first, last) {
  const place = $("marks");
  const marks = [...live.events].filter(([, event]) => event.mark).map(([number, event]) => {
    const x = (100 * (Number(number) - first)) / Math.max(1, last - first);
    const mark = svg("text", { x: `${x.toFixed(2)}%`, y: 13, "data-mark": event.mark, "data-record": number }, MARKS[event.mark], svg("title", {}, `record ${number}: ${event.lines[0]}`));
    mark.addEventListener("click", () => go(Number(number)));
    return mark;
  });
  place.replaceChildren(...marks);
}

// --- people ---

$("way").addEventListener("input", () => go(Number($("way").value)));
$("back").addEventListener("click", () => step(-1));
$("forward").addEventListener("click", () => step(1));
$("to-mark-before").addEventListener("click", () => toMark(-1));
$("to-mark-after").addEventListener("click", () => toMark(1));
$("live").addEventListener("click", goLive);
$("run-choice").addEventListener("change", () => {
  chosenRun = $("run-choice").value;
  chosenCall = "";
  draw(["runs", "calls"]);
});
$("call-choice").addEventListener("change", () => choose($("call-choice").value));
$("fact-filter").addEventListener("input", () => draw(["facts"]));
$("fact-false").addEventListener("change", () => draw(["facts"]));
new ResizeObserver(() => draw(["time"])).observe($("lanes")); // it may have no width yet when the first frame comes
addEventListener("keydown", (key) => {
  if (key.target.closest("input, select, textarea, .scrolls") || key.altKey || key.ctrlKey || key.metaKey) return;
  if (key.key === "ArrowLeft") step(-1);
  if (key.key === "ArrowRight") step(1);
});

connect();
openControls(() => draw(["tasks", "calls"]));
