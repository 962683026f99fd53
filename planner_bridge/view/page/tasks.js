// The tasks and robots at the left, what needs a person, and the head of the chosen task.

import { answerForm, hasNode, taskButtons, whyNoPlan } from "./controls.js";
import { doneOf, expectedEnd, robotsOf, taskState, titleOf, wayOf } from "./model.js";
import { actionOf, button, clock, el, icon, keepingFocus, keyed, look, pill, placed, span, statePill, tod, words } from "./words.js";

export const NO_PLAN = new Set(["no_plan", "planner_timeout", "replan_limit"]);
const $ = (id) => document.getElementById(id);
const SEGMENTS = 48; // so many calls have a segment each; of more, a segment stands for several

export function ordered(model) {
  return [...model.tasks].sort(([, a], [, b]) => (a.state === "over") - (b.state === "over") || b.priority - a.priority || a.order - b.order);
}

export const questionsOf = (model) => [...model.questions].filter(([, question]) => question.who === "a person");

function segments(way, isAsked) {
  const size = Math.max(1, Math.ceil(way.length / SEGMENTS));
  const parts = [];
  for (let at = 0; at < way.length; at += size) {
    const colours = way.slice(at, at + size).map(([, call]) => look(call.state)[1]);
    const first = ["bad", "run", "ask"].find((one) => colours.includes(one)) ?? (colours.every((one) => one === "ok") ? "ok" : "dim");
    parts.push(el("i", { class: first === "run" && isAsked ? "ask" : first }));
  }
  return parts.length ? el("span", { class: "seg", "aria-hidden": "true" }, ...parts) : "";
}

const looksOf = (way) => way.map(([, call]) => look(call.state)[1][0]).join("");

// What is left of a task, or what it waits for, in a few words.
function restOf(model, id, task, state, now) {
  if (state === "asks") return "asks you";
  if (["paused", "pausing", "planning", "replanning", "queued", "cancelling"].includes(state)) return look(state)[2];
  const end = expectedEnd(model, id, task, now);
  return end === null ? "" : `${span(end - now)} left`;
}

export function showLeft(model, ui, now, chooseTask, choose) {
  const tasks = ordered(model);
  const open = tasks.filter(([, task]) => task.state !== "over");
  const asks = questionsOf(model).length;
  const said = asks ? `${asks} need${asks > 1 ? "" : "s"} you` : "nothing needs you";
  if ($("pill").dataset.said !== said) {
    $("pill").dataset.said = said;
    $("pill").replaceChildren(asks ? pill("ask", "ask", said) : pill("ok", "ok", said));
  }
  const entries = open.map(([id, task]) => {
    const state = taskState(model, id, task);
    const [sign, colour, word] = look(state);
    const way = wayOf(model, id, task);
    const [title, rest, done] = [titleOf(task), restOf(model, id, task, state, now), way.length ? `${doneOf(way)}/${way.length}` : ""];
    const looks = [title, state, rest, looksOf(way), ui.task === id && !ui.day].join("\n");
    return [id, looks, { class: "it", "data-task": id, "data-how": state, "aria-current": ui.task === id && !ui.day ? "true" : null, title: task.title }, () => [
      icon(sign, colour), el("span", { class: "el" }, el("span", { class: "l1" }, el("b", { class: "el" }, title), el("span", { class: "sr" }, word)),
        el("span", { class: "l2" }, segments(way, state === "asks"), el("span", {}, done), el("span", { class: "sp" }), el("span", { class: `el ${state === "asks" ? "ask" : ""}` }, rest)))]];
  });
  keyed($("task-list"), "button", entries, chooseTask);
  if (!open.length) placed($("task-list"), [el("p", { class: "empty" }, tasks.length ? "No task runs or waits." : "No tasks yet.")]);
  showRobots(model, ui, now, choose);
  const over = tasks.filter(([, task]) => task.state === "over").sort(([, a], [, b]) => b.ended - a.ended);
  $("over-part").hidden = !over.length;
  keyed($("over"), "button", over.slice(0, 12).map(([id, task]) => {
    const [sign, colour, word] = look(task.code);
    const [title, at] = [titleOf(task), tod(model, task.ended, false)];
    return [id, [title, at, task.code, ui.task === id && !ui.day].join("\n"), { class: "it one", "data-task": id, "data-how": task.code, "aria-current": ui.task === id && !ui.day ? "true" : null, title: `${task.title}: ${word}` },
      () => [icon(sign, colour), el("span", { class: "l2" }, el("span", { class: "el" }, title), el("span", { class: "sp" }), el("span", {}, at))]];
  }), chooseTask);
}

function showRobots(model, ui, now, choose) {
  const robots = robotsOf(model);
  $("robot-count").textContent = robots.length || "";
  keyed($("robots"), "button", robots.map((robot) => {
    const [sign, colour, first, second] = robotWords(model, robot, now);
    const battery = robot.battery === null ? "" : `${Math.round(100 * robot.battery)} %`;
    const isChosen = ui.sel?.kind === "robot" && ui.sel.key === robot.name;
    return [robot.name, [sign, colour, ...first, second, battery, isChosen].join("\n"), { class: "it", "data-robot": robot.name, "aria-current": isChosen ? "true" : null, title: `${robot.name}: ${first.join(" ")}` }, () => {
      const level = el("i");
      level.style.width = `${Math.round(100 * (robot.battery ?? 0))}%`;
      return [icon(sign, colour), el("span", { class: "el" }, el("span", { class: "l1" }, el("b", {}, robot.name), el("span", { class: "el" }, first[0], el("span", { class: "dim" }, ` ${first[1]}`))),
        el("span", { class: "l2" }, el("span", { class: "el" }, second), el("span", { class: "sp" }), battery ? el("span", { class: `bat ${robot.battery < 0.25 ? "low" : ""}` }, level) : "", battery ? el("span", {}, battery) : ""))];
    }];
  }), (name) => choose({ kind: "robot", key: name }));
  if (!robots.length) placed($("robots"), [el("p", { class: "empty" }, "None has done anything yet.")]);
}

// The sign of a robot, its colour, what it does to what, and what comes next.
export function robotWords(model, robot, now) {
  const next = robot.next && actionOf(robot.next.call.action, robot.name);
  const soon = robot.next?.origin !== null && robot.next?.call.duration !== null && robot.next ? robot.next.origin + robot.next.call.planned - now : 0;
  const then = next ? `next ${next.name}${soon > 1 ? `, in ${span(soon)}` : ""}` : robot.now ? "nothing after that" : "";
  if (robot.hand) return ["hand", "ask", ["", robot.hand.replace(/^\S+ is /, "").replace(/ since .*/, "")], then || "nothing is sent to it"];
  if (robot.now) {
    const { name, objects } = actionOf(robot.now.call.action, robot.name);
    return ["run", "run", [name, objects.at(-1) ?? ""], then];
  }
  if (next) return ["wait", "dim", ["waits", `to ${next.name}`], then];
  return ["wait", "dim", ["ready", ""], robot.last ? `idle for ${span(now - robot.last.call.ended)}` : ""];
}

// --- what needs a person ---

export function showNeeds(model, isNow) {
  const questions = questionsOf(model).map(([id, question], place) => {
    const task = model.tasks.get(question.task);
    const subject = task ? titleOf(task) : question.subject;
    const form = isNow ? answerForm(id, question, place === 0) : "";
    const label = question.choices.includes("yes") ? "Can it be reached?" : undefined; // else help is asked for because there is no plan
    const why = isNow && question.choices.length && task ? whyNoPlan(id, task.title, label) : "";
    return el("div", { class: "need asks", "data-question": id }, icon("ask"),
      el("div", {}, el("p", {}, question.text), el("small", { class: "dim" }, `${subject} · asks since ${tod(model, question.since)}${task?.deadline != null ? `, gives up at ${clock(task.deadline)}` : ""}${form ? "" : "; answer with: pnm answer TEXT"}`)), form, why);
  });
  placed($("needs"), questions);
}

// --- the head of a task ---

let asked = { id: "", element: null };

function more(id, choose) {
  if (asked.id !== id) asked = { id, element: button("more", "all about the task, with its troubles", () => choose({ kind: "task", key: id }), "link") };
  asked.element.setAttribute("aria-label", "more of the task");
  return asked.element;
}

export function showHead(model, id, now, isNow, choose) {
  const task = model.tasks.get(id);
  const place = $("task");
  if (!task) {
    placed(place, [el("h2", {}, model.number ? "Nothing has been asked for yet" : "Nothing is known yet")]);
    return;
  }
  const state = taskState(model, id, task);
  const way = wayOf(model, id, task);
  const title = titleOf(task);
  const isOver = task.state === "over";
  const elapsed = (isOver ? task.ended : now) - task.time;
  const end = isOver ? null : expectedEnd(model, id, task, now);
  const stat = (value, text) => el("span", {}, el("b", {}, value), text ? el("span", { class: "dim" }, text) : "");
  const stats = [statePill(state, isOver && task.code !== "goal_reached" ? words(task.code) : undefined)];
  if (way.length) stats.push(el("span", {}, segments(way, state === "asks"), el("b", {}, `${doneOf(way)} of ${way.length}`)));
  stats.push(isOver ? stat(span(elapsed), `long, until ${tod(model, task.ended)}`) : stat(span(elapsed), "so far"));
  if (end !== null) stats.push(stat(span(end - now), `to go, ends ${tod(model, end)}`));
  if (task.odds?.words) stats.push(el("span", { class: "odds", title: `${task.odds.words} likely to reach the goal without a new plan; in 90 % of such runs within ${span(task.odds.seconds?.ninety_percent ?? 0)}; ${task.odds.rests_on}` }, el("b", {}, task.odds.words), el("span", { class: "dim" }, "odds")));
  stats.push(more(id, choose));
  if (task.priority) stats.push(stat(String(task.priority), "priority"));
  if (task.deadline !== null && !isOver) stats.push(el("span", {}, el("span", { class: "dim" }, "due"), el("b", {}, clock(task.deadline))));
  const reason = state === "asks" || task.code === "goal_reached" || (task.state === "running" && /^[\w-]+\(.*\) runs?$/s.test(task.reason)) ? "" : task.reason;
  const heading = el("h2", { class: "el", title: task.title || null }, title);
  keepingFocus(() => placed(place, [el("div", { class: "row task", "data-how": state }, heading, el("span", { class: "sp" }), isNow ? taskButtons(id, task, title) : ""),
    el("div", { class: "stats" }, ...stats), reason ? el("p", { class: "reason" }, reason) : "",
    isNow && NO_PLAN.has(task.code) && hasNode() ? whyNoPlan(id, task.title) : ""].filter(Boolean)));
}
