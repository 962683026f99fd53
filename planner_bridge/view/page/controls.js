// Controls: what people may want of tasks, for those whose URL had the token. It is sent with every command, and kept for this tab alone.

import { el, reasons, words } from "./words.js";

const KEY = "pnm-token";
const given = /^#token=([\w-]+)$/.exec(location.hash);
if (given) {
  sessionStorage.setItem(KEY, given[1]);
  history.replaceState(null, "", location.pathname); // out of sight, of bookmarks and of the history
}
const token = sessionStorage.getItem(KEY);
let what = "nothing";

export const hasControls = () => what !== "nothing";

const said = document.getElementById("command-said");

function say(text, isBad) {
  said.textContent = text;
  said.classList.toggle("bad", isBad);
}

async function asked(method, command, signal) {
  const headers = { authorization: `Bearer ${token}` };
  if (command) headers["content-type"] = "application/json";
  const answer = await fetch("/control", { method, headers, signal, body: command && JSON.stringify(command) });
  return answer.json();
}

// Has a command carried out; returns whether it was not refused.
async function wanted(command, done) {
  try {
    const reply = await asked("POST", command);
    say(reply.refused ? `✕ ${whereIn(reply)}${reply.refused}` : `✓ ${done}`, Boolean(reply.refused));
    return !reply.refused;
  } catch {
    say("✕ the page is not there any more", true);
    return false;
  }
}

function whereIn(reply) {
  return reply.column ? `${reply.line > 1 ? `line ${reply.line}, ` : ""}column ${reply.column}: ` : "";
}

// Asks once what may be controlled here, and shows the controls for that.
export async function openControls(draw) {
  const note = document.getElementById("control-note");
  if (token) {
    try {
      const reply = await asked("GET");
      what = reply.what ?? "nothing";
      note.textContent = reply.refused ? `✕ ${reply.refused}` : "";
    } catch {
      note.textContent = "✕ not connected";
    }
  }
  document.getElementById("commands").hidden = !hasControls();
  document.getElementById("node-commands").hidden = what !== "node";
  if (hasControls()) draw();
}

// --- of tasks and calls ---

const made = new Map();

// The buttons of a thing: made anew only when they are others, so that they keep the focus.
function buttonsOf(key, label, buttons) {
  const looks = buttons.map(([text]) => text).join("|");
  const old = made.get(key);
  if (old?.looks === looks) return old.element;
  const element = el("span", { class: "commands", role: "group", "aria-label": label }, ...buttons.map(([text, title, act]) => {
    const button = el("button", { type: "button", title }, text);
    button.addEventListener("click", act);
    return button;
  }));
  made.set(key, { looks, element });
  return element;
}

export function taskButtons(id, task) {
  if (!hasControls() || task.state === "over") return "";
  const name = task.goal;
  const isPaused = task.state === "paused" || task.state === "pausing";
  const buttons = isPaused
    ? [["▶ Resume", "let it go on", () => wanted({ do: "resume", task: id }, `${name} goes on`)]]
    : [["‖ Pause", "start nothing more; what runs comes to its end", () => wanted({ do: "pause", task: id }, `${name} pauses`)],
      ["‖ Pause at once", "cancel what runs, to begin it anew later", () => wanted({ do: "pause", task: id, at_once: true }, `${name} pauses at once`)]];
  if (task.state === "paused" && task.runs.length) buttons.push(["▶│ Step", "let the next request leave, and no other", () => wanted({ do: "step", task: id }, "one request has left")]);
  buttons.push(["✕ Cancel", "end it; what runs is cancelled", () => confirm(`Cancel ${name}?`) && wanted({ do: "cancel", task: id }, `${name} is cancelled`)]);
  return buttonsOf(`task ${id}`, `commands for ${name}`, buttons);
}

export function requestButtons(id, request) {
  if (!hasControls()) return "";
  const settle = (outcome, isDone) => () => confirm(`Its server is told to cancel it. Once that is done with it, ${request.action} counts as ${outcome}, because you say so.`)
    && wanted({ do: "settle", request: id, is_done: isDone }, `${request.action} counts as ${outcome} as soon as its server is done with it`);
  return buttonsOf(`request ${id}`, `how ${request.action} ends`, [
    ["✓ It is done", "have it count as done", settle("done", true)], ["✕ It has failed", "have it count as failed", settle("failed", false)]]);
}

export function giveButton(name) {
  if (!hasControls()) return "";
  return buttonsOf(`hand ${name}`, `commands for ${name}`, [
    ["▶ Give back", "have tasks use it again, from what sensors say then", () => wanted({ do: "give", name }, `${name} is given back`)]]);
}

// --- why ---

// Shows whether a goal can be reached from what is so now: a plan for it, or why there is none and what would help.
async function explained(text, button, place) {
  button.disabled = true;
  place.replaceChildren(el("p", { class: "soft" }, "looks for a plan …"));
  try {
    const reply = await asked("POST", { do: "why", goal: text });
    if (reply.refused) place.replaceChildren(el("p", { class: "bad" }, `✕ ${whereIn(reply)}${reply.refused}`));
    else place.replaceChildren(el("p", { class: "soft" }, "from what is so when all that runs now has come to its end:"), reasons(reply.answers));
  } catch {
    place.replaceChildren(el("p", { class: "bad" }, "✕ the page is not there any more"));
  }
  button.disabled = false;
}

// A button that asks for the plan of a goal, or why there is none, and the answer below it.
export function whyNoPlan(key, text, label = "Why is there no plan?") {
  if (what !== "node") return "";
  const name = `why ${key}`;
  if (!made.has(name)) {
    const place = el("div", { "aria-live": "polite" });
    const button = el("button", { type: "button", title: "as things are now: the plan, or why there is none and what would help" }, label);
    button.addEventListener("click", () => explained(text, button, place));
    made.set(name, { element: el("div", { class: "no-plan" }, button, place) });
  }
  return made.get(name).element;
}

// --- of questions ---

export function answerForm(id, question) {
  if (!hasControls()) return "";
  const key = `question ${id}`;
  if (!made.has(key)) made.set(key, { element: question.choices.length ? choicesOf(id, question) : fieldOf(id) });
  return made.get(key).element;
}

const answer = (id, text) => wanted({ do: "answer", question: id, text }, `answered: ${text}`);

function choicesOf(id, question) {
  const buttons = question.choices.map((choice) => {
    const button = el("button", { type: "button" }, words(choice));
    button.addEventListener("click", () => answer(id, choice));
    return button;
  });
  return el("p", { class: "commands", role: "group", "aria-label": "answers" }, ...buttons);
}

function fieldOf(id) {
  const field = el("input", { type: "text", autocomplete: "off", spellcheck: "false", required: true });
  const form = el("form", { class: "answer" }, el("label", {}, "answer ", field), el("button", {}, "Answer"));
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    answer(id, field.value);
  });
  return form;
}

// --- of the node ---

const goal = document.getElementById("goal");
const goalSaid = document.getElementById("goal-said");
let checking = null;
let waiting = 0;

function checkedSoon() {
  clearTimeout(waiting);
  waiting = setTimeout(check, 150);
}

async function check() {
  checking?.abort();
  checking = new AbortController();
  const text = goal.value;
  try {
    const reply = await asked("POST", { do: "check", goal: text }, checking.signal);
    goal.setAttribute("aria-invalid", String(Boolean(reply.refused)));
    goalSaid.classList.toggle("bad", Boolean(reply.refused));
    goalSaid.textContent = reply.refused ? `✕ ${whereIn(reply)}${reply.refused}` : text.trim() ? "✓ this can be a goal" : "empty: the goal of the problem";
  } catch (error) {
    if (error.name !== "AbortError") goalSaid.textContent = "✕ not connected";
  }
}

goal.addEventListener("input", checkedSoon);
goal.addEventListener("input", () => document.getElementById("goal-reasons").replaceChildren());
document.getElementById("goal-why").addEventListener("click", (event) => explained(goal.value, event.target, document.getElementById("goal-reasons")));
goal.addEventListener("focus", checkedSoon);
document.getElementById("goal-form").addEventListener("submit", async (event) => {
  event.preventDefault();
  clearTimeout(waiting);
  const priority = Number(document.getElementById("priority").value) || 0;
  if (await wanted({ do: "goal", goal: goal.value, priority }, `sent: ${goal.value.trim() || "the goal of the problem"}`)) {
    goal.value = "";
    goalSaid.textContent = "";
    document.getElementById("goal-reasons").replaceChildren();
  } else check();
});

const fact = document.getElementById("fact");
document.getElementById("fact-form").addEventListener("submit", async (event) => {
  event.preventDefault();
  const how = document.getElementById("fact-how").value;
  const told = { add: [], remove: [], forget: [], [how]: [fact.value] };
  if (await wanted({ do: "tell", ...told }, `told: ${fact.value} ${{ add: "is so", remove: "is not so", forget: "is unknown" }[how]}`)) fact.value = "";
});
const robot = document.getElementById("robot");
const robotReason = document.getElementById("robot-reason");
document.getElementById("robot-form").addEventListener("submit", async (event) => {
  event.preventDefault();
  const name = robot.value.trim();
  if (await wanted({ do: "take", name, reason: robotReason.value }, `${name} is taken over, what it does is cancelled`)) robot.value = robotReason.value = "";
});
document.getElementById("pause-all").addEventListener("click", () => wanted({ do: "pause" }, "all tasks pause, those to come as well"));
document.getElementById("resume-all").addEventListener("click", () => wanted({ do: "resume" }, "all tasks go on"));
