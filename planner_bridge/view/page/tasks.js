// What needs me now: what failed and why, questions to people, and the tasks.

import { answerForm, giveButton, taskButtons, whyNoPlan } from "./controls.js";
import { timeNow } from "./model.js";
import { clock, el, keepingFocus, seconds, state, words } from "./words.js";

const NO_PLAN = new Set(["no_plan", "planner_timeout", "replan_limit"]);

// The text of a goal as it was sent: none for that of the problem.
const goalOf = (shown) => (shown === "the goal of the problem" ? "" : shown);

// Shows them; what can be done about them, if they are those of now.
export function showTasks(model, isNow) {
  keepingFocus(() => show(model, isNow));
}

function show(model, isNow) {
  const tasks = [...model.tasks.entries()].sort(([, a], [, b]) => (a.state === "over") - (b.state === "over") || b.priority - a.priority || a.order - b.order);
  left = [];
  showNeeds(model, tasks, isNow);
  const open = tasks.filter(([, task]) => task.state !== "over");
  const over = tasks.filter(([, task]) => task.state === "over").reverse();
  const shown = open.length ? open : over.slice(0, 1);
  const others = over.filter((entry) => !shown.includes(entry));
  const list = document.getElementById("task-list");
  const wasOpen = list.querySelector("details")?.open;
  list.replaceChildren(...shown.map((entry) => taskOf(model, isNow, ...entry)));
  if (!tasks.length) list.append(el("p", { class: "soft" }, "no tasks yet"));
  if (others.length) {
    const more = el("details", {}, el("summary", {}, `${others.length} more that ${others.length > 1 ? "are" : "is"} over`), ...others.map((entry) => taskOf(model, isNow, ...entry)));
    more.open = Boolean(wasOpen);
    list.append(more);
  }
}

function taskOf(model, isNow, id, task) {
  const facts = [`accepted at ${clock(task.accepted)}`];
  if (task.counts) facts.push(task.counts);
  if (task.priority) facts.push(`priority ${task.priority}`);
  if (task.deadline !== null) facts.push(`has to be done by ${clock(task.deadline)}`);
  if (task.limit !== null) facts.push(`${seconds(task.used, 1)} of ${seconds(task.limit, 0)} used`);
  const how = task.code || task.state;
  const word = task.code === "goal_reached" ? "✓ goal reached" : task.code ? words(task.code) : words(task.state);
  return el("div", { class: "task", "data-task": id, "data-how": how },
    state(task.code && task.code !== "goal_reached" ? "failed" : how, word),
    el("span", { class: "goal" }, task.goal),
    el("span", { class: "soft num" }, task.state === "over" ? "over" : ""),
    task.reason ? el("span", { class: "more reason" }, task.reason) : "",
    task.odds ? oddsOf(model, isNow, task.odds) : "",
    el("span", { class: "more" }, facts.join(" · ")),
    isNow ? taskButtons(id, task) : "",
    isNow && NO_PLAN.has(task.code) ? whyNoPlan(id, goalOf(task.goal)) : "");
}

let left = []; // the times that run down

// The chance of the goal and the time to it, and what that rests on.
function oddsOf(model, isNow, odds) {
  const text = el("span", { class: "num" });
  left.push({ model, isNow, odds, text });
  runDown();
  return el("span", { class: "more odds" }, el("strong", {}, `${odds.words} `), text,
    el("span", { class: "soft" }, ` · ${odds.rests_on}`));
}

function runDown() {
  for (const { model, isNow, odds, text } of left) {
    const since = (isNow ? timeNow(model) : model.time) - odds.at;
    const [median, most] = [odds.seconds.median, odds.seconds.ninety_percent].map((time) => seconds(Math.max(0, time - since), 0));
    text.textContent = `likely to reach the goal without a new plan, in ${median}; in 90 % of such runs within ${most}`;
  }
}
setInterval(runDown, 500);

// What people may have to do something about: questions, robots in their hands, and troubles that nothing has followed yet.
function showNeeds(model, tasks, isNow) {
  const questions = [...model.questions].map(([id, question]) => questionOf(model, isNow, id, question));
  const troubles = [...model.troubles.values()].sort((a, b) => b.time - a.time);
  const isOpen = (trouble) => !trouble.followed;
  const before = troubles.filter((trouble) => !isOpen(trouble));
  const place = document.getElementById("needs");
  const wasOpen = place.querySelector("details")?.open;
  const hands = [...model.hands].map(([name, hand]) => el("div", { class: "need asks", "data-hand": name },
    el("p", {}, el("strong", {}, `‖ ${hand.words}`), " ", isNow ? giveButton(name) : "")));
  const needs = [...questions, ...hands, ...troubles.filter(isOpen).map((trouble) => troubleOf(model, trouble, true))];
  place.replaceChildren(...(needs.length || !tasks.length ? needs : [el("p", { class: "soft" }, "nothing")]));
  if (before.length) {
    const more = el("details", {}, el("summary", {}, `${before.length} ${before.length > 1 ? "troubles" : "trouble"} before, and what followed`),
      ...before.slice(0, 50).map((trouble) => troubleOf(model, trouble, true)));
    more.open = Boolean(wasOpen);
    place.append(more);
  }
}

function questionOf(model, isNow, id, question) {
  const form = isNow && question.who === "a person" ? answerForm(id, question) : "";
  const where = question.who === "a person" && !form ? "; answer at the terminal of pnm run, or on the topic knowledge/answers of pnm serve" : "";
  const label = question.choices.includes("yes") ? "Can it be reached?" : undefined; // else help is asked for because there is no plan
  const why = isNow && question.choices.length ? whyNoPlan(id, goalOf(question.subject), label) : "";
  return el("div", { class: "need asks", "data-question": id },
    el("p", {}, el("strong", {}, `? ${question.who} is asked: `), question.text),
    el("p", { class: "soft" }, `for ${question.subject}, since ${seconds(question.since - model.began)}${where}`), form, why);
}

// What a call was hindered by, or has failed with.
export function troubleOf(model, trouble, hasStep) {
  const what = hasStep ? `${trouble.step} ${trouble.is_failure ? "failed" : "was hindered"}: ` : trouble.is_failure ? "failed: " : "hindered: ";
  return el("div", { class: "need", "data-cause": trouble.cause },
    el("p", {}, el("strong", {}, `✕ ${what}${words(trouble.cause)}`), el("span", { class: "soft" }, ` at ${seconds(trouble.time - model.began)}`)),
    el("dl", { class: "pair" },
      el("dt", {}, "expected"), el("dd", { class: "expected" }, trouble.expected || "–"),
      el("dt", {}, "observed"), el("dd", { class: "observed" }, trouble.observed || "–"),
      el("dt", {}, "then"), el("dd", {}, trouble.followed || "not decided yet")));
}
