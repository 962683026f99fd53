// The dock: events, knowledge, servers. What can be started while nothing runs. And a day, hour by hour.

import { hasNode, startForms, tellForm } from "./controls.js";
import { eventsOf, titleOf } from "./model.js";
import { KNOWN, clock, counted, el, figure, icon, inWords, keyed, look, mark, pill, span, svg, tod, widthOf, words } from "./words.js";

const $ = (id) => document.getElementById(id);
const SHOWN = 120;
const filter = el("input", { type: "search", class: "btn", id: "fact-filter", "aria-label": "facts with", placeholder: "facts with", autocomplete: "off", spellcheck: "false" });
const falseToo = el("input", { type: "checkbox", id: "fact-false" });
const falseLabel = el("label", { class: "row sm" }, falseToo, "false ones as well");
const lists = Object.fromEntries(["events", "facts", "servers"].map((name) => [name, el("div", { id: { events: "event-list", facts: "facts", servers: "server-list" }[name] })]));

export function watchLists(redraw) {
  filter.addEventListener("input", redraw);
  falseToo.addEventListener("change", redraw);
}

export function showDock(model, ui, isNow, choose) {
  for (const name of Object.keys(lists)) {
    $(`tab-${name}`).setAttribute("aria-selected", String(ui.tab === name));
    $(`tab-${name}`).tabIndex = ui.tab === name ? 0 : -1;
  }
  $("dock").setAttribute("aria-labelledby", `tab-${ui.tab}`);
  const tools = ui.tab === "facts" ? [filter, falseLabel] : ui.tab === "events" ? [el("small", { class: "dim" }, "newest first")] : [];
  if ($("dock-tools").dataset.tab !== ui.tab) {
    $("dock-tools").dataset.tab = ui.tab;
    $("dock-tools").replaceChildren(...tools);
  }
  const tell = ui.tab === "facts" && isNow && hasNode() ? [tellForm()] : [];
  const wanted = [...tell, lists[ui.tab]];
  if ($("dock").childElementCount !== wanted.length || wanted.some((each, at) => $("dock").children[at] !== each)) $("dock").replaceChildren(...wanted);
  ({ events: showEvents, facts: showFacts, servers: showServers })[ui.tab](model, ui, choose);
}

function showEvents(model, ui, choose) {
  const events = eventsOf(model).slice(0, SHOWN);
  const seen = new Map(); // one event may be told twice in the same words
  keyed(lists.events, "button", events.map((event) => {
    const times = seen.get(event.id) ?? 0;
    seen.set(event.id, times + 1);
    const isChosen = ui.sel?.kind === "event" && ui.sel.key === event.id;
    const text = `${event.name} ${event.text}`;
    return [times ? `${event.id} ${times}` : event.id, `${text}${isChosen}${model.clock}`, { class: "ev", title: text, "aria-current": isChosen ? "true" : null },
      () => [el("small", { class: "dim" }, tod(model, event.time)), icon(event.sign, event.colour), el("span", { class: "el" }, el("b", {}, event.name), ` ${event.text}`)]];
  }), (id) => choose({ kind: "event", key: id }));
}

function showFacts(model, ui, choose) {
  const wanted = filter.value.trim().toLowerCase().split(/\s+/);
  const facts = [...model.facts].filter(([name, fact]) => (falseToo.checked || fact.value !== "false") && wanted.every((word) => name.toLowerCase().includes(word)))
    .sort(([, a], [, b]) => b.since - a.since).slice(0, 4 * SHOWN);
  keyed(lists.facts, "button", facts.map(([name, fact]) => {
    const isStale = fact.source === "sensed" && fact.value === "unknown"; // nothing reports it any more
    const value = `${figure(fact.value)}${fact.was ? ` (was ${fact.was})` : ""}`;
    return [name, `${value} ${fact.source} ${fact.since}`, { class: `ev fact${isStale ? " stale" : ""}`, "data-fact": name, title: `${inWords(name)}: ${value}` },
      () => [el("span", { class: "el mono" }, name), el("b", { class: "el" }, value), el("small", {}, isStale ? "◍ stale" : KNOWN[fact.source]), el("small", { class: "dim" }, fact.is_initial ? "start" : tod(model, fact.since))]];
  }), (name) => choose({ kind: "fact", key: name }));
}

function showServers(model) {
  keyed(lists.servers, "div", [...model.servers].map(([name, server]) => [name, JSON.stringify(server), { class: "ev server", "data-server": name, title: `${name}: ${server.actions.join(", ")}` }, () => [
    el("span", { class: "el mono" }, name), el("span", { class: `el ${server.busy.length ? "run" : "dim"}` }, server.busy.length ? server.busy.join(", ") : "idle"),
    el("small", { class: server.failed ? "bad" : "dim" }, server.failed ? `${server.failed} failed` : "")]]));
}

// --- while nothing runs ---

export function showStarts(model, isIdle, isNow) {
  const forms = isIdle && isNow ? startForms(model) : null;
  $("starts").hidden = !forms;
  if (forms) {
    if ($("starts").firstElementChild !== forms[0]) $("starts").replaceChildren(...forms);
  }
}

// --- a day ---

let told = { number: -1, tasks: [] };

// Asks for all the tasks of the journal, if they are others than before.
export async function askDay(model, redraw) {
  if (told.number === model.number || told.asked === model.number) return;
  told.asked = model.number;
  const tasks = await fetch(`/day?at=${model.number}`).then((answer) => (answer.ok ? answer.json() : null), () => null);
  if (!tasks) return;
  told = { number: model.number, tasks };
  redraw();
}

const dayOf = (wall) => new Date(wall * 1000).toDateString();

export function showDay(model, ui, width, choose) {
  const section = $("day");
  section.hidden = !ui.day;
  if (!ui.day) return;
  const days = [...new Set(told.tasks.map((task) => dayOf(task.accepted)))];
  const day = days.at(-1 - ui.day.back) ?? days[0];
  const tasks = told.tasks.filter((task) => dayOf(task.accepted) === day);
  const looks = JSON.stringify([told.number, day, width, ui.day.hour, tasks.length]);
  if (section.dataset.looks === looks) return;
  section.dataset.looks = looks;
  const over = tasks.filter((task) => task.code);
  const done = over.filter((task) => task.code === "goal_reached");
  const given = over.filter((task) => task.code !== "goal_reached");
  const times = done.map((task) => task.seconds).sort((a, b) => a - b);
  const stat = (sign, colour, value, text) => el("span", {}, sign ? icon(sign, colour) : "", el("b", {}, value), el("span", { class: "dim" }, text));
  const turn = (by) => () => choose({ kind: "day", back: Math.max(0, Math.min(days.length - 1, ui.day.back + by)) });
  const step = (label, sign, by) => {
    const made = el("button", { type: "button", class: "btn ico", "aria-label": label, title: label }, icon(sign));
    made.addEventListener("click", turn(by));
    return made;
  };
  const reasons = new Map();
  for (const task of given) reasons.set(task.reason || words(task.code), [...(reasons.get(task.reason || words(task.code)) ?? []), task]);
  const title = tasks.length ? new Date(tasks[0].accepted * 1000).toLocaleDateString("en-GB", { weekday: "long", day: "numeric", month: "long" }) : "A day";
  section.replaceChildren(el("div", { class: "row" }, el("h2", { id: "day-title", class: "ti" }, title), el("span", { class: "sp" }), step("the day before", "back", 1), step("the next day", "fwd", -1)),
    el("div", { class: "stats" }, stat("", "", String(tasks.length), tasks.length === 1 ? "task" : "tasks"), stat("ok", "ok", String(done.length), "done"), stat("bad", given.length ? "bad" : "dim", String(given.length), "given up"),
      stat("cut", "cut", String(tasks.reduce((sum, task) => sum + Math.max(0, task.plans - 1), 0)), "new plans"), times.length ? stat("", "", span(times[Math.floor(times.length / 2)]), "median") : ""),
    hoursOf(tasks, width, ui, choose),
    given.length ? el("h2", {}, "What was given up") : "", given.length ? el("div", { class: "box" }, ...[...reasons].sort(([, a], [, b]) => b.length - a.length).slice(0, 8).map(([reason, those]) => el("div", { class: "ln", title: reason },
      icon("bad", "bad"), el("b", {}, String(those.length)), el("span", { class: "el sp" }, reason), el("span", { class: "dim" }, those.map((task) => clock(task.accepted, false)).slice(0, 4).join(" "))))) : "");
}

const SHADES = [0.06, 0.18, 0.36, 0.58, 0.82];

// Tasks an hour, those given up, and how busy each robot was, in cells of a quarter of an hour.
function hoursOf(tasks, width, ui, choose) {
  if (!tasks.length) return el("p", { class: "dim" }, "no task on this day");
  const hour = (wall) => new Date(wall * 1000).getHours() + new Date(wall * 1000).getMinutes() / 60 + new Date(wall * 1000).getSeconds() / 3600;
  const robots = [...new Set(tasks.flatMap((task) => Object.keys(task.busy)))].sort((a, b) => a.localeCompare(b, "en", { numeric: true }));
  const first = Math.floor(Math.min(...tasks.map((task) => hour(task.accepted))));
  const last = Math.max(first + 1, Math.ceil(Math.max(...tasks.map((task) => Math.max(hour(task.accepted) + 0.01, task.ended ? hour(task.ended) : 0)))));
  const left = Math.max(56, ...robots.map((name) => widthOf(name, true) + 8));
  const x = (at) => left + ((at - first) / (last - first)) * (width - left);
  const counts = Array.from({ length: last - first }, (_, at) => tasks.filter((task) => Math.floor(hour(task.accepted)) === first + at));
  const most = Math.max(1, ...counts.map((those) => those.length));
  const parts = [svg("text", { class: "td", x: 0, y: 66 }, "tasks"), svg("text", { class: "td", x: 0, y: 86 }, "given up")];
  counts.forEach((those, at) => {
    const [from, wide] = [x(first + at) + 2, x(first + at + 1) - x(first + at) - 4];
    const high = Math.round((50 * those.length) / most);
    const bad = those.filter((task) => task.code && task.code !== "goal_reached").length;
    if (ui.day.hour === first + at) parts.unshift(svg("rect", { class: "hour", x: from - 2, y: 0, width: wide + 4, height: 96 + robots.length * 26, rx: 4 }));
    const group = svg("g", { role: "button", tabindex: 0, "aria-label": `${first + at} to ${first + at + 1} o'clock: ${those.length} tasks, ${bad} given up` }, svg("rect", { class: "day-bar", x: from, y: 70 - high, width: Math.max(1, wide), height: high, rx: 2 }),
      those.length ? svg("text", { class: "tb", x: from + wide / 2, y: 65 - high, "text-anchor": "middle" }, String(those.length)) : "");
    if (bad) group.append(mark("bad", from + wide / 2 - 13, 76, "bad"), svg("text", { class: "tb", x: from + wide / 2 + 2, y: 86 }, String(bad)));
    const act = () => choose({ kind: "day", back: ui.day.back, hour: first + at });
    group.addEventListener("click", act);
    group.addEventListener("keydown", (key) => key.key === "Enter" && act());
    parts.push(group);
    const every = Math.ceil(44 / Math.max(1, wide + 4));
    if (at % every === 0) parts.push(svg("text", { class: "td", x: from, y: 112 + robots.length * 26 }, `${String(first + at).padStart(2, "0")}:00`));
  });
  robots.forEach((name, row) => {
    const y = 96 + row * 26;
    parts.push(svg("path", { class: "ax", d: `M0 ${y}H${width}` }), svg("text", { class: "tb", x: 0, y: y + 18 }, name));
    const quarters = new Map();
    for (const task of tasks) for (const [from, to] of task.busy[name] ?? []) {
      for (let at = Math.floor(hour(from) * 4); at <= Math.floor(hour(to) * 4); at += 1) {
        quarters.set(at, (quarters.get(at) ?? 0) + Math.max(0, Math.min(hour(to), (at + 1) / 4) - Math.max(hour(from), at / 4)) * 4);
      }
    }
    for (let at = first * 4; at < last * 4; at += 1) {
      const share = Math.min(1, quarters.get(at) ?? 0);
      parts.push(svg("rect", { class: "cell", x: x(at / 4) + 1, y: y + 5, width: Math.max(1, x((at + 1) / 4) - x(at / 4) - 1.5), height: 16, rx: 2, "fill-opacity": SHADES[Math.ceil(share * 4)] }, svg("title", {}, `${name}, ${Math.floor(at / 4)}:${String((at % 4) * 15).padStart(2, "0")}: at work ${Math.round(100 * share)} %`)));
    }
  });
  return svg("svg", { class: "g", width, height: 118 + robots.length * 26, viewBox: `0 0 ${width} ${118 + robots.length * 26}`, role: "group", "aria-label": "the day by hours" }, ...parts);
}

// The tasks of the chosen hour, for the inspector.
export function hourOf(model, ui, choose) {
  const days = [...new Set(told.tasks.map((task) => dayOf(task.accepted)))];
  const day = days.at(-1 - ui.day.back) ?? days[0];
  const those = told.tasks.filter((task) => dayOf(task.accepted) === day && (ui.day.hour === undefined || new Date(task.accepted * 1000).getHours() === ui.day.hour));
  const bad = those.filter((task) => task.code && task.code !== "goal_reached");
  const title = ui.day.hour === undefined ? "The whole day" : `${ui.day.hour}:00 to ${ui.day.hour + 1}:00`;
  const lines = those.slice(-40).reverse().map((task) => {
    const [sign, colour] = look(task.code || "running");
    const line = el("button", { type: "button", class: "it one", title: `${task.title}: ${task.reason}` }, icon(sign, colour), el("span", { class: "l2" }, el("span", { class: "el" }, titleOf(task)), el("span", { class: "sp" }),
      el("span", { class: colour === "bad" ? "bad" : "" }, colour === "bad" ? "given up" : task.plans > 1 ? `${task.plans} plans` : task.code ? span(task.seconds) : "running"), el("span", {}, clock(task.accepted, false))));
    line.addEventListener("click", () => model.tasks.has(task.id) && choose({ kind: "task", key: task.id }));
    return line;
  });
  return [el("section", {}, el("div", { class: "row" }, el("h2", { class: "ti" }, title), el("span", { class: "sp" }), el("small", { class: "dim" }, counted(those.length, "task"))),
    el("div", { class: "row commands" }, pill("ok", "ok", `${those.filter((task) => task.code === "goal_reached").length} done`), bad.length ? pill("bad", "bad", `${bad.length} given up`) : "")), el("section", {}, ...lines)];
}
