// The state that is shown: parts with things by key, as the server tells them. A frame changes it. And what follows from it.

import { DONE, actionOf, clock, counted, inWords, look, stateOf, words } from "./words.js";

export const PARTS = ["tasks", "runs", "calls", "requests", "facts", "servers", "questions", "hands", "troubles", "events"];
const HEAD = ["number", "time", "began", "first", "problem", "clock", "journal", "name", "host", "watching"];

export function nothing() {
  const model = { number: 0, time: 0, began: 0, first: 0, problem: "", clock: null, journal: "", name: "", host: "", watching: 1, heard: null, made: new Map() };
  for (const part of PARTS) model[part] = new Map();
  return model;
}

// Returns the model after a frame, and the names of the parts that it has changed.
export function applied(model, frame) {
  const next = frame.is_whole ? nothing() : model;
  for (const name of HEAD) next[name] = frame[name];
  next.heard = { at: performance.now(), isWhole: frame.is_whole };
  next.made = new Map();
  for (const [part, things] of Object.entries(frame.parts)) {
    for (const [key, thing] of Object.entries(things)) {
      if (thing === null) next[part].delete(key);
      else next[part].set(key, thing);
    }
  }
  return [next, frame.is_whole ? PARTS : Object.keys(frame.parts)];
}

// Returns the time on the clock of the records now: it goes on while nothing is recorded.
export function timeNow(model) {
  if (!model.heard) return model.time;
  const since = (performance.now() - model.heard.at) / 1000;
  const now = model.heard.isWhole && model.clock !== null ? Date.now() / 1000 - model.clock : model.time + since;
  return Math.max(model.time, now);
}

// Makes something of a model once between two frames.
function once(model, key, make) {
  if (!model.made.has(key)) model.made.set(key, make());
  return model.made.get(key);
}

const by = (things, key) => {
  const found = new Map();
  for (const entry of things) {
    const name = key(entry[1]);
    if (!found.has(name)) found.set(name, []);
    found.get(name).push(entry);
  }
  return found;
};

export const callsOf = (model, run) => once(model, "calls", () => by(model.calls, (call) => call.run)).get(run) ?? [];
export const requestsOf = (model, run) => once(model, "requests", () => by(model.requests, (request) => request.run)).get(run) ?? [];
export const taskOf = (model, run) => once(model, "tasks", () => new Map([...model.tasks].flatMap(([id, task]) => task.runs.map((one) => [one, id])))).get(run) ?? "";
const ownRuns = (model, task) => task.runs.filter((run) => model.runs.get(run)?.is_own);

// Whether a run has another plan than the one before it, and does not only go on with its rest; and which plan of its task that is.
export const isOther = (run) => Boolean(run?.replan && !run.is_foreseen && (run.replan.dropped.length || run.replan.added.length));

export function titleOf(task) {
  if (!task) return "";
  const given = Object.entries(task.given ?? {}).map(([name, value]) => `${name}: ${value}`).join(", ");
  const text = inWords(task.title) || `task of ${clock(task.accepted)}`;
  return `${text.slice(0, 1).toUpperCase()}${text.slice(1)}${given ? ` (${given})` : ""}`;
}

// The state of a task for people: how it ended, or what it does.
export function taskState(model, id, task) {
  if (task.code) return task.code;
  return [...model.questions.values()].some((question) => question.task === id && question.who === "a person") ? "asks" : task.state;
}

// The calls that a task has made and will make, in the order of time: those that were done in earlier plans, and those of the last one.
export function wayOf(model, id, task) {
  return once(model, `way ${id}`, () => {
    const runs = ownRuns(model, task);
    const inTime = (entries) => entries.sort(([, a], [, b]) => (a.started ?? Infinity) - (b.started ?? Infinity) || a.planned - b.planned || a.index - b.index);
    const before = runs.slice(0, -1).flatMap((run) => inTime(callsOf(model, run).filter(([, call]) => DONE.has(call.state))));
    return [...before, ...(runs.length ? inTime([...callsOf(model, runs.at(-1))]) : [])];
  });
}

export const doneOf = (way) => way.filter(([, call]) => DONE.has(call.state)).length;

// When a task may be over if all goes as planned, late as it is; null if nobody knows.
export function expectedEnd(model, id, task, now) {
  if (task.odds?.seconds) return Math.max(now, task.odds.at + task.odds.seconds.median);
  const run = ownRuns(model, task).at(-1);
  const origin = model.runs.get(run)?.origin ?? null;
  const calls = callsOf(model, run).map(([, call]) => call).filter((call) => !["skipped", "passed_over"].includes(call.state));
  if (origin === null || !calls.length || calls.some((call) => call.duration === null) || !calls.some((call) => call.planned + call.duration > 0)) return null;
  const late = calls.filter((call) => call.state === "running").map((call) => Math.max(call.started - origin - call.planned, now - origin - call.planned - call.duration));
  const waiting = calls.filter((call) => call.state === "waiting").map((call) => origin + call.planned);
  const delay = Math.max(0, ...late, waiting.length && !late.length ? now - Math.min(...waiting) : 0);
  return Math.max(now, ...calls.filter((call) => call.ended === null).map((call) => origin + call.planned + call.duration + delay));
}

// The robots, each with what it does, what comes next, and what is known of its battery.
export function robotsOf(model) {
  return once(model, "robots", () => {
    const robots = new Map();
    const of = (name) => {
      if (!robots.has(name)) robots.set(name, { name, now: null, next: null, last: null, hand: "", battery: null });
      return robots.get(name);
    };
    for (const [id, task] of model.tasks) {
      const runs = ownRuns(model, task);
      for (const run of task.runs) {
        const isOpen = task.state !== "over" && (run === runs.at(-1) || !model.runs.get(run)?.is_own);
        for (const [key, call] of callsOf(model, run)) {
          if (call.action.startsWith(`${call.lane}(`)) continue; // it is nobody's
          const robot = of(call.lane);
          const entry = { key, call, task: id, origin: model.runs.get(run)?.origin ?? null };
          if ((call.state === "running" || call.state === "suspended") && isOpen && !model.runs.get(run).is_over) robot.now ??= entry;
          else if (call.state === "waiting" && isOpen && !(robot.next?.call.planned <= call.planned && robot.next.task === id)) robot.next ??= entry;
          if (call.ended !== null && !(robot.last?.call.ended >= call.ended)) robot.last = entry;
        }
      }
    }
    for (const [name, hand] of model.hands) of(name).hand = hand.words;
    for (const [name, fact] of model.facts) {
      const [, who] = /^\((?:battery|charge|battery_level|battery-level) ([^\s)]+)\)$/.exec(name) ?? [];
      if (who && robots.has(who) && Number.isFinite(Number(fact.value))) robots.get(who).battery = Number(fact.value) > 1 ? Number(fact.value) / 100 : Number(fact.value);
    }
    return [...robots.values()].sort((a, b) => a.name.localeCompare(b.name, "en", { numeric: true }));
  });
}

// What has happened, in words, the last of it first.
const told = new WeakMap(); // what is told of requests that are over, which stay as they are

export function eventsOf(model) {
  return once(model, "events", () => {
    const events = [];
    const make = (time, sign, colour, name, text, more = {}) => ({ time, sign, colour, name, text, rank: 3, key: "", task: "", ...more, id: `${time} ${sign} ${name} ${text} ${more.key ?? ""}` });
    const add = (...parts) => events.push(make(...parts));
    for (const [id, task] of model.tasks) {
      add(task.time, "wait", "dim", titleOf(task), "accepted", { task: id, rank: 0 });
      ownRuns(model, task).slice(0, 1).forEach((run) => add(model.runs.get(run).time, "cut", "dim", "Plan", `of ${counted(callsOf(model, run).length, "call")} for ${titleOf(task)}`, { task: id, rank: 2 }));
      if (task.ended !== null) add(task.ended, task.code === "goal_reached" ? "ok" : "bad", task.code === "goal_reached" ? "ok" : "bad", titleOf(task), `${look(task.code)[2]}${task.code === "goal_reached" ? "" : `: ${task.reason}`}`, { task: id, rank: 4 });
    }
    for (const [key, request] of model.requests) {
      if (told.has(request)) {
        events.push(...told.get(request));
        continue;
      }
      const first = events.length;
      const { name, objects } = actionOf(request.action, request.lane);
      const what = [request.lane === name ? "" : request.lane, ...objects].filter(Boolean).join(" ");
      const about = { key: `${request.run}/${request.call}`, task: taskOf(model, request.run), request: key };
      add(request.sent, "run", "run", name, `${what} began${request.attempt > 1 ? `, attempt ${request.attempt}` : ""}`, about);
      if (request.ended === null) continue;
      const [sign, colour, word] = look(stateOf(request, true));
      add(request.ended, sign, colour, name, `${what} ${request.declared || (colour === "bad" ? `failed: ${words(request.outcome)}` : word)}${request.message ? `: ${request.message}` : ""}`, { ...about, rank: 1 });
      if (about.task) told.set(request, events.slice(first));
    }
    for (const [, run] of model.runs) {
      if (run.replan) add(run.time, "cut", "cut", isOther(run) ? "New plan" : "Goes on", run.replan.why, { rank: 2 });
    }
    for (const [id, question] of model.questions) add(question.since, "ask", "ask", "Question", question.text, { task: question.task, question: id });
    for (const [, event] of model.events) for (const line of event.lines) add(event.time, "hand", "ask", line, "");
    return events.sort((a, b) => b.time - a.time || b.rank - a.rank);
  });
}
