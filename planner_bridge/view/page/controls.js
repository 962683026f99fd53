// Controls: what people may want of tasks, for those whose URL had the token. It is sent with every command, and kept for this tab alone.

import { button, counted, el, icon, inWords, reasons, signButton, span, words } from "./words.js";

const KEY = "pnm-token";
const $ = (id) => document.getElementById(id);
const given = /^#token=([\w-]+)$/.exec(location.hash);
if (given) {
  sessionStorage.setItem(KEY, given[1]);
  history.replaceState(null, "", location.pathname); // out of sight, of bookmarks and of the history
}
const token = sessionStorage.getItem(KEY);
let what = "nothing";
let plans = {}; // the hand-written plans that can be started: their parameters, with values

export const hasControls = () => what !== "nothing";
export const hasNode = () => what === "node";

let fading = 0;

export function say(text, isBad = false) {
  const said = $("command-said");
  said.textContent = text;
  said.classList.toggle("bad", isBad);
  clearTimeout(fading);
  if (!isBad) fading = setTimeout(() => (said.textContent = ""), 30000);
}

async function asked(method, command, signal) {
  const headers = { authorization: `Bearer ${token}` };
  if (command) headers["content-type"] = "application/json";
  const answer = await fetch("/control", { method, headers, signal, body: command && JSON.stringify(command) });
  return answer.json();
}

// Has a command carried out; returns whether it was not refused.
export async function wanted(command, done) {
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
export async function openControls(redraw) {
  const note = $("control-note");
  if (token) {
    try {
      const reply = await asked("GET");
      what = reply.what ?? "nothing";
      note.textContent = reply.refused ? `✕ ${reply.refused}` : "";
      if (hasNode()) plans = (await asked("POST", { do: "plans" })).plans ?? {};
    } catch {
      note.textContent = "✕ not connected";
    }
  }
  redraw();
}

// Shows the controls for all tasks, if they are those of now.
export function showControls(isNow, hasOpen) {
  $("goal-form").hidden = !hasNode() || !isNow;
  $("goal-open").hidden = !hasNode() || !isNow;
  $("pause-all").hidden = !hasNode() || !isNow;
  $("resume-all").hidden = !hasNode() || !isNow || !hasOpen;
}

// --- of tasks and calls ---

const made = new Map();

// The elements of a thing: made anew only when they are to look otherwise, so that they keep the focus.
function once(key, looks, make) {
  const old = made.get(key);
  if (old?.looks === looks) return old.element;
  const element = make();
  made.set(key, { looks, element });
  return element;
}

export const taskDoes = {
  pause: (id, title) => wanted({ do: "pause", task: id }, `${title} pauses`),
  resume: (id, title) => wanted({ do: "resume", task: id }, `${title} goes on`),
  step: (id) => wanted({ do: "step", task: id }, "one request has left"),
  cancel: (id, title) => confirm(`Cancel ${title}?`) && wanted({ do: "cancel", task: id }, `${title} is cancelled`),
};

export const isHeld = (task) => task.state === "paused" || task.state === "pausing";

export function taskButtons(id, task, title) {
  if (!hasControls() || task.state === "over") return "";
  const canStep = task.state === "paused" && task.runs.length;
  return once(`task ${id}`, `${isHeld(task)} ${canStep} ${title}`, () => el("span", { class: "row", role: "group", "aria-label": `commands for ${title}` },
    ...(isHeld(task) ? [signButton("run", "Resume", "let it go on (p)", () => taskDoes.resume(id, title))]
      : [signButton("pause", "Pause", "start nothing more; what runs comes to its end (p)", () => taskDoes.pause(id, title)),
        signButton("halt", "Pause at once", "cancel what runs, to begin it anew later", () => wanted({ do: "pause", task: id, at_once: true }, `${title} pauses at once`))]),
    ...(canStep ? [signButton("step", "Step", "let the next request leave, and no other (.)", () => taskDoes.step(id))] : []),
    signButton("bad", "Cancel", "end it; what runs is cancelled (x)", () => taskDoes.cancel(id, title))));
}

export function requestButtons(id, request) {
  if (!hasControls()) return "";
  const settle = (outcome, isDone) => () => confirm(`Its server is told to cancel it. Once that is done with it, ${request.action} counts as ${outcome}, because you say so.`)
    && wanted({ do: "settle", request: id, is_done: isDone }, `${request.action} counts as ${outcome} as soon as its server is done with it`);
  return once(`request ${id}`, "", () => el("span", { class: "commands", role: "group", "aria-label": `how ${request.action} ends` },
    button([icon("ok"), "It is done"], "have it count as done", settle("done", true)), button([icon("bad"), "It has failed"], "have it count as failed", settle("failed", false))));
}

export function robotCommands(name, isTaken) {
  if (!hasNode()) return "";
  return once(`robot ${name}`, String(isTaken), () => {
    if (isTaken) return el("section", {}, button([icon("run"), "Give back"], "have tasks use it again, from what sensors say then", () => wanted({ do: "give", name }, `${name} is given back`)));
    const reason = el("input", { class: "btn", type: "text", autocomplete: "off", placeholder: "the gripper is stuck" });
    const form = el("form", { class: "take" }, el("label", {}, "because", reason), el("button", { class: "btn", title: "cancel what it does, and send nothing to it until you give it back" }, `Take ${name} over`));
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      wanted({ do: "take", name, reason: reason.value }, `${name} is taken over, what it does is cancelled`);
    });
    return el("section", {}, el("h3", {}, "Drive it yourself"), form);
  });
}

// --- why ---

// Shows whether a goal can be reached from what is so now: a plan for it, or why there is none and what would help.
async function explained(text, asking, place) {
  asking.disabled = true;
  place.replaceChildren(el("p", { class: "dim" }, "looks for a plan …"));
  try {
    const reply = await asked("POST", { do: "why", goal: text });
    if (reply.refused) place.replaceChildren(el("p", { class: "bad" }, `✕ ${whereIn(reply)}${reply.refused}`));
    else place.replaceChildren(el("p", { class: "reason" }, "from what is so when all that runs now has come to its end:"), reasons(reply.answers));
  } catch {
    place.replaceChildren(el("p", { class: "bad" }, "✕ the page is not there any more"));
  }
  asking.disabled = false;
}

// A button that asks for the plan of a goal, or why there is none, and the answer below it.
export function whyNoPlan(key, text, label = "Why is there no plan?") {
  if (!hasNode()) return "";
  return once(`why ${key}`, label, () => {
    const place = el("div", { "aria-live": "polite" });
    return el("div", { class: "no-plan" }, button(label, "as things are now: the plan, or why there is none and what would help", (click) => explained(text, click.currentTarget, place)), place);
  });
}

export const askButton = (id, task) => (hasNode() && !Object.keys(task.given).length && task.title.startsWith("(") && task.state === "over" ? el("section", {}, whyNoPlan(`again ${id}`, task.title, "Can it be reached now?")) : null);

// --- of questions ---

export function answerForm(id, question, isFirst) {
  if (!hasControls()) return "";
  return once(`question ${id}`, String(isFirst), () => (question.choices.length ? choicesOf(id, question, isFirst) : fieldOf(id, question, isFirst)));
}

const answer = (id, text) => wanted({ do: "answer", question: id, text }, `answered: ${text}`);
export const keyOf = (choice, place, all) => (all.length === 2 && all.includes("yes") && all.includes("no") ? choice[0] : String(place + 1));

function choicesOf(id, question, isFirst) {
  return el("span", { class: "row", role: "group", "aria-label": "answers" }, ...question.choices.map((choice, place, all) => {
    const made = button([words(choice), isFirst ? el("kbd", { "aria-hidden": "true" }, keyOf(choice, place, all)) : ""].filter(Boolean), `answer ${words(choice)}`, () => answer(id, choice), place === 0 ? "btn askp" : "btn");
    made.dataset.answer = keyOf(choice, place, all);
    return made;
  }));
}

function fieldOf(id, question, isFirst) {
  const field = el("input", { class: "btn", type: "text", autocomplete: "off", spellcheck: "false", required: true, "aria-label": `answer: ${question.text}` });
  const form = el("form", {}, field, el("button", { class: "btn" }, "Answer"));
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    answer(id, field.value);
  });
  field.placeholder = "in words";
  if (/\b(yes\/no|go on|ok)\b.{0,8}\?$/i.test(question.text)) return el("span", { class: "row" }, choicesOf(id, { choices: ["yes", "no"] }, isFirst), form);
  return form;
}

// --- of the node ---

const goal = $("goal");
const goalSaid = $("goal-said");
let checking = null;
let waiting = 0;
let isLooking = false; // a plan takes a processor: one is looked for at a time

function checkedSoon() {
  clearTimeout(waiting);
  shown("");
  waiting = setTimeout(check, 150);
}

function shown(text, colour = "", title = text) {
  $("goal-look").textContent = text;
  $("goal-look").title = title;
  $("goal-look").className = `said ${colour}`;
}

// Shows what a plan for the goal that is typed would take, once nobody has typed for a while.
async function look() {
  if (isLooking || document.activeElement !== goal) return;
  isLooking = true;
  const text = goal.value;
  let reply = { refused: "not connected" };
  try {
    reply = await asked("POST", { do: "look", goal: text });
  } catch {
    // the check says that the server is not there
  }
  isLooking = false;
  if (goal.value !== text) waiting = setTimeout(check, 150);
  else if (reply.refused) shown("a plan was not looked for", "", reply.refused);
  else if (reply.calls === null) shown("no plan as things are", "bad", reply.reason);
  else shown([reply.calls ? counted(reply.calls, "call") : "is so already", reply.calls && reply.seconds !== null ? span(reply.seconds) : "", reply.chance ?? ""].filter(Boolean).join(" · "), "ok",
    `a plan from what is so when all that runs now has ended${reply.chance ? `; ${reply.chance} likely without a new plan, ${reply.rests_on}` : ""}`);
}

function told(text, colour) {
  goalSaid.textContent = text;
  goalSaid.title = text;
  goalSaid.className = `said ${colour}`;
  $("send").classList.toggle("pri", colour === "ok");
}

async function check() {
  checking?.abort();
  checking = new AbortController();
  const text = goal.value;
  if (!text.trim()) {
    goal.setAttribute("aria-invalid", "false");
    told("empty: the problem's own goal", "");
    return;
  }
  try {
    const reply = await asked("POST", { do: "check", goal: text }, checking.signal);
    goal.setAttribute("aria-invalid", String(Boolean(reply.refused)));
    if (reply.refused) told(`✕ ${whereIn(reply)}${reply.refused}`, "bad");
    else {
      told(`✓ ${inWords(text)}`, "ok");
      waiting = setTimeout(look, 450);
    }
  } catch (error) {
    if (error.name !== "AbortError") told("✕ not connected", "bad");
  }
}

goal.addEventListener("input", () => {
  $("goal-reasons").replaceChildren();
  checkedSoon();
});
goal.addEventListener("focus", () => {
  $("goal-box").hidden = false;
  checkedSoon();
});
export function closeGoal() {
  $("goal-box").hidden = true;
  $("goal-form").classList.remove("open");
  clearTimeout(waiting);
  shown("");
  if (!goal.value) told("", "");
}
addEventListener("pointerdown", (pointer) => {
  if (!pointer.target.closest("#goal-form, #goal-box, #goal-open")) closeGoal();
});
document.addEventListener("focusin", (focus) => {
  if (!focus.target.closest("#goal-form, #goal-box, #goal-open")) closeGoal();
});
export function openGoal() {
  $("goal-form").classList.add("open");
  goal.focus();
}
$("goal-open").addEventListener("click", openGoal);
$("goal-why").addEventListener("click", (event) => explained(goal.value, event.currentTarget, $("goal-reasons")));
$("goal-form").addEventListener("submit", async (event) => {
  event.preventDefault();
  clearTimeout(waiting);
  if (await wanted({ do: "goal", goal: goal.value, priority: Number($("priority").value) || 0 }, `sent: ${goal.value.trim() || "the problem's own goal"}`)) {
    goal.value = "";
    $("goal-reasons").replaceChildren();
    closeGoal();
    goal.blur();
    told("", "");
  } else check();
});

export function tellForm() {
  return once("tell", "", () => {
    const fact = el("input", { class: "btn wide mono", id: "fact", type: "text", autocomplete: "off", spellcheck: "false", required: true, placeholder: "(blocked door)", "aria-label": "a fact" });
    const how = el("select", { class: "btn", id: "fact-how", "aria-label": "that" }, el("option", { value: "add" }, "is so"), el("option", { value: "remove" }, "is not so"), el("option", { value: "forget" }, "is unknown"));
    const form = el("form", { class: "tell", id: "fact-form" }, fact, how, el("button", { class: "btn" }, "Tell"));
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      const text = { add: "is so", remove: "is not so", forget: "is unknown" }[how.value];
      if (await wanted({ do: "tell", add: [], remove: [], forget: [], [how.value]: [fact.value] }, `told: ${fact.value} ${text}`)) fact.value = "";
    });
    return form;
  });
}

// What can be started: goals that were reached before, and hand-written plans by forms of their parameters.
export function startForms(model) {
  const before = [...new Map([...model.tasks.values()].filter((task) => task.code && task.title.startsWith("(") && !Object.keys(task.given).length).map((task) => [task.title, task])).values()].slice(-4).reverse();
  const names = Object.keys(plans);
  if (!hasNode() || (!before.length && !names.length)) return null;
  return [once("starts", JSON.stringify([before.map((task) => task.title), plans]), () => el("div", {},
    ...(before.length ? [el("div", { class: "row" }, el("h2", { id: "starts-title" }, "Send again")), el("div", { class: "box" }, ...before.map((task) => el("div", { class: "ln" },
      el("span", { class: "el sp", title: task.title }, inWords(task.title)), button("Send", `send ${task.title}`, () => wanted({ do: "goal", goal: task.title }, `sent: ${task.title}`)))))] : []),
    ...(names.length ? [el("div", { class: "row" }, el("h2", { id: before.length ? null : "starts-title" }, "Start a plan"), el("span", { class: "sp" }), el("small", { class: "dim" }, "written by hand")),
      el("div", { class: "box" }, ...names.map(planForm))] : [])))];
}

function planForm(name) {
  const fields = Object.entries(plans[name]).map(([parameter, value]) => [parameter, el("input", { class: "btn mono num", type: "text", autocomplete: "off", spellcheck: "false", value: value ?? "", required: value === null })]);
  const form = el("form", { class: "ln", "data-plan": name }, el("b", { class: "sp" }, name), ...fields.map(([parameter, field]) => el("label", {}, parameter, field)), el("button", { class: "btn" }, "Start"));
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    wanted({ do: "start", plan: name, given: Object.fromEntries(fields.filter(([, field]) => field.value !== "").map(([parameter, field]) => [parameter, field.value])) }, `started: ${name}`);
  });
  return form;
}

$("pause-all").addEventListener("click", () => wanted({ do: "pause" }, "all tasks pause, those to come as well"));
$("resume-all").addEventListener("click", () => wanted({ do: "resume" }, "all tasks go on"));
