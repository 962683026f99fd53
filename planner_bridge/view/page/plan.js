// The plan of a run: cards in the order of time, and links that carry the fact that is waited for; and the policy that it is a part of.

import { callsOf, isOther, taskOf } from "./model.js";
import { DONE, actionOf, el, fitted, icon, inWords, look, mark, svg, widthOf } from "./words.js";

const CARD = [112, 44], GAP = 76, ROW = 72, HEAD = 24, EDGE = 4; // four columns fit beside the inspector at 1280
const $ = (id) => document.getElementById(id);
let told = null; // the layout of the plan that is shown: {run, sections}
let asked = ""; // the run whose layout is fetched
let boxes = new Map(); // the cards that are there, by step; those of dropped calls by the key of the call
let shown = ""; // what the cards were drawn for
let range = [0, 0, 0, 0]; // the part that is drawn: from which column to which, and from which height to which
let view = { left: 0, top: 0, width: 0, height: 0 }; // the part that is seen; to ask while a frame is drawn has the browser lay out the page

const place = $("picture");
const columnOf = (pixels) => Math.floor((pixels - EDGE) / (CARD[0] + GAP));

export function watchPlan(redraw) {
  const seen = () => (view = { left: place.scrollLeft, top: place.scrollTop, width: place.clientWidth, height: place.clientHeight });
  place.addEventListener("scroll", () => {
    seen();
    if (isOutside()) redraw();
  });
  new ResizeObserver(() => {
    seen();
    redraw();
  }).observe(place);
}

const sight = () => [columnOf(view.left), columnOf(view.left + view.width), view.top, view.top + view.height];

function isOutside() {
  const [first, last, top, bottom] = sight();
  return first < range[0] || last > range[1] || top < range[2] || bottom > range[3];
}

// Asks for the layout of a run, which never changes; returns whether it is there.
async function fetched(model, run, redraw) {
  if (asked === run) return;
  asked = run;
  const sections = await fetch(`/plan?run=${run}&at=${model.number}`).then((answer) => (answer.ok ? answer.json() : null), () => null);
  if (asked !== run) return; // another one is wanted by now
  asked = "";
  if (!sections) return;
  told = { run, ...positions(sections), follows: "" };
  shown = "";
  redraw();
}

// Where every step stands, and its links.
function positions(sections) {
  const cells = new Map(), links = [], titles = [];
  let top = 8, columns = 0;
  for (const { name, cells: own, arrows } of sections) {
    if (name) {
      titles.push({ name, y: top });
      top += HEAD;
    }
    for (const cell of own) {
      cells.set(cell.step, { ...cell, x: EDGE + cell.column * (CARD[0] + GAP), y: top + cell.row * ROW });
      columns = Math.max(columns, cell.column + 1);
    }
    links.push(...arrows.filter((arrow) => !arrow.is_for_the_end));
    top += (1 + Math.max(-1, ...own.map((cell) => cell.row))) * ROW + (own.length ? 0 : 8);
  }
  const port = (mine, others) => {
    const sides = new Map();
    for (const link of links) sides.set(link[mine], [...(sides.get(link[mine]) ?? []), link]);
    for (const side of sides.values()) {
      side.sort((a, b) => cells.get(a[others]).row - cells.get(b[others]).row);
      const pitch = Math.min(18, (CARD[1] - 8) / side.length);
      side.forEach((link, at) => (link[`${mine}Port`] = (at - (side.length - 1) / 2) * pitch));
    }
  };
  port("before", "after");
  port("after", "before");
  const occupied = new Set([...cells.values()].map((cell) => `${cell.column} ${cell.y}`));
  return { cells, links, titles, occupied, width: 2 * EDGE + columns * (CARD[0] + GAP) - GAP, height: Math.max(60, top - ROW + CARD[1] + 14) };
}

export function showPlan(model, run, calls, chosen, choose, redraw) {
  $("plan").hidden = !run;
  $("plan-title").textContent = isOther(model.runs.get(run)) ? "New plan" : "Plan";
  const why = isOther(model.runs.get(run)) ? model.runs.get(run).replan.why.replace(/^a new plan is needed: /, "") : "";
  $("plan-why").textContent = why.split(";")[0];
  $("plan-why").title = why;
  if (!run) return;
  showChanges(isOther(model.runs.get(run)) ? model.runs.get(run).replan : null);
  if (told?.run !== run) {
    fetched(model, run, redraw);
    return;
  }
  const stateOf = (step) => model.calls.get(`${run}/${step}`);
  if (!told.cells.size) {
    place.replaceChildren(el("p", { class: "dim" }, "nothing is to be done: the plan has no calls"));
    return;
  }
  keepInSight(calls);
  const added = new Set((isOther(model.runs.get(run)) && model.runs.get(run).replan.added) || []);
  const dropped = droppedOf(model, run);
  const looks = [run, ...dropped.map(([key]) => key)].join(" ");
  if (shown !== looks || isOutside()) {
    const [first, last, top, bottom] = sight();
    range = [first - 3, last + 3, top - 300, Math.max(bottom, top + 320) + 300];
    shown = looks;
    draw(run, choose, added, dropped);
  }
  const gone = new Map(dropped);
  for (const [step, { box, cell }] of boxes) showState(box, cell, gone.get(step) ?? stateOf(step), [`${run}/${step}`, step].includes(chosen));
  for (const link of place.querySelectorAll("[data-from]")) link.classList.toggle("on", stateOf(link.dataset.from)?.state === "running");
}

// The calls that a new plan has dropped, of the plan before it, until something of the new one is done.
function droppedOf(model, id) {
  const run = model.runs.get(id);
  if (!isOther(run) || !run.replan.dropped.length || callsOf(model, id).some(([, call]) => call.ended > run.time)) return [];
  const own = (model.tasks.get(taskOf(model, id))?.runs ?? []).filter((one) => model.runs.get(one)?.is_own);
  const left = callsOf(model, own[own.indexOf(id) - 1]).filter(([, call]) => !DONE.has(call.state));
  return run.replan.dropped.flatMap((text) => {
    const at = left.findIndex(([, call]) => call.action === text);
    return at < 0 ? [] : left.splice(at, 1);
  }).sort(([, a], [, b]) => a.planned - b.planned);
}

// Follows what runs, unless somebody looks elsewhere.
function keepInSight(calls) {
  const now = calls.filter(([, call]) => call.state === "running" || call.state === "failed").map(([, call]) => call.index).sort().join(" ");
  if (told.follows === now || !view.width || place.matches(":hover, :focus-within")) return;
  told.follows = now;
  const xs = now ? now.split(" ").map((step) => told.cells.get(Number(step))?.x ?? 0) : [];
  if (!xs.length) return;
  const [left, right] = [Math.min(...xs), Math.max(...xs) + CARD[0]];
  if (left >= view.left && right <= view.left + view.width) return;
  requestAnimationFrame(() => (place.scrollLeft = left - CARD[0] - GAP)); // in the next frame, when there is room, and all is laid out
}

function draw(run, choose, added, dropped) {
  const isNear = (cell) => cell.column >= range[0] && cell.column <= range[1] && cell.y >= range[2] - ROW && cell.y <= range[3];
  const focused = document.activeElement?.closest?.("#picture [role=button]");
  const had = [...boxes].find(([, each]) => each.box === focused)?.[0];
  boxes = new Map();
  const links = told.links.filter((link) => {
    const [a, b] = [told.cells.get(link.before), told.cells.get(link.after)];
    return a.column <= range[1] && b.column >= range[0] && Math.min(a.y, b.y) <= range[3] && Math.max(a.y, b.y) >= range[2] - ROW;
  });
  const drawn = links.map(linkOf);
  const cards = [...told.cells.values()].filter(isNear).sort((a, b) => a.column - b.column || a.row - b.row).map((cell) => cardOf(cell, run, choose, added));
  const below = told.height - 8 + HEAD;
  const gone = dropped.map(([key, call], at) => boxOf({ x: EDGE + at * (CARD[0] + 24), y: below, name: call.action.split("(")[0], whole: `dropped: ${call.action}` }, key, "dropped", "drop", () => choose(key, run)));
  const titles = [...told.titles, ...(gone.length ? [{ name: "dropped from the plan before", y: below - 28 }] : [])];
  const [wide, high] = [Math.max(told.width, 2 * EDGE + gone.length * (CARD[0] + 24) - 24), told.height + (gone.length ? HEAD + 8 + CARD[1] : 0)];
  const picture = svg("svg", { class: "g", width: wide, height: high, viewBox: `0 0 ${wide} ${high}`, role: "group", "data-run": run },
    ...titles.map(({ name, y }) => svg("text", { class: "td", x: EDGE, y: y + 14 }, name)), ...drawn.map((each) => each.line), ...drawn.flatMap((each) => each.text), ...cards, ...gone);
  place.replaceChildren(picture);
  boxes.get(had)?.box.focus({ preventScroll: true });
}

function linkOf(link) {
  const [a, b] = [told.cells.get(link.before), told.cells.get(link.after)];
  const [x1, y1, x2, y2] = [a.x + CARD[0], a.y + CARD[1] / 2 + link.beforePort, b.x, b.y + CARD[1] / 2 + link.afterPort];
  const isFar = b.column > a.column + 1;
  const isBlocked = isFar && Array.from({ length: b.column - a.column - 1 }, (_, at) => `${a.column + 1 + at} ${b.y}`).some((key) => told.occupied.has(key));
  const channel = b.y + (b.y <= a.y && b.y !== a.y ? CARD[1] + 20 : -8);
  const middle = x1 + GAP / 2;
  const d = isBlocked ? `M${x1} ${y1}C${x1 + 30} ${y1} ${x1 + 14} ${channel} ${x1 + 46} ${channel}H${x2 - 46}C${x2 - 14} ${channel} ${x2 - 30} ${y2} ${x2 - 5} ${y2}`
    : `M${x1} ${y1}C${middle} ${y1} ${middle} ${y2} ${Math.min(middle + GAP / 2, x2) - 5} ${y2}H${x2 - 5}`;
  const facts = link.protects.map(inWords).join(", ");
  const line = svg("g", { "data-from": link.before, class: "link" }, svg("title", {}, facts || `#${link.before} before #${link.after}`), svg("path", { class: "lk", d }), svg("path", { class: "tip", d: `M${x2 - 6} ${y2 - 3.5}L${x2} ${y2}L${x2 - 6} ${y2 + 3.5}z` }));
  return { line, text: isBlocked ? factOf(link, (x1 + x2 - GAP) / 2, channel, channel, true) : factOf(link, x1, y1, y2) };
}

// The fact on a link, whole or cut: above a level one, on a chip where it slants. Bookkeeping gives way to another fact of the same link.
function factOf(link, x1, y1, y2, isDetour = false) {
  const facts = [...link.protects].sort((a, b) => /^\((free|idle|ready|empty|available)\b/.test(a) - /^\((free|idle|ready|empty|available)\b/.test(b));
  if (!facts.length) return [];
  const more = facts.length > 1 ? ` +${facts.length - 1}` : "";
  const text = `${fitted(inWords(facts[0]), GAP - 2 - widthOf(more))}${more}`;
  const title = svg("title", {}, facts.map(inWords).join("\n"));
  if (Math.abs(y1 - y2) < 4) return [svg("text", { class: "td fact", x: x1 + GAP / 2, y: link.beforePort > 0 && !isDetour ? y1 + 15 : y1 - 5, "text-anchor": "middle" }, text, title)];
  const [wide, y] = [widthOf(text) + 6, (y1 + y2) / 2];
  return [svg("rect", { class: "chip", x: x1 + GAP / 2 - wide / 2, y: y - 9, width: wide, height: 18 }), svg("text", { class: "td fact", x: x1 + GAP / 2, y: y + 4, "text-anchor": "middle" }, text, title)];
}

function cardOf(cell, run, choose, added) {
  const isAdded = added.has(cell.whole.split(", planned at")[0].replace(/#\d+$/, "")) || added.has(`${cell.name}(${cell.what})`);
  return boxOf(cell, cell.step, isAdded ? "added" : "", isAdded ? "add" : "", () => choose(`${run}/${cell.step}`));
}

function boxOf(cell, key, looks, sign, act) {
  const box = svg("g", { "data-step": cell.step, tabindex: 0, role: "button", class: looks }, svg("title", {}, cell.reaches_goal ? `${cell.whole}\nreaches the goal` : cell.whole),
    svg("rect", { class: "ring", x: cell.x - 3.5, y: cell.y - 3.5, width: CARD[0] + 7, height: CARD[1] + 7, rx: 9 }),
    svg("rect", { class: "card", x: cell.x + 0.5, y: cell.y + 0.5, width: CARD[0] - 1, height: CARD[1] - 1, rx: 6 }), svg("g", { class: "badge" }));
  if (cell.reaches_goal) box.append(mark("flag", cell.x + CARD[0] - 18, cell.y + 26, "dim"));
  if (sign) box.append(svg("rect", { class: sign === "add" ? "badge-cut" : "badge-bad", x: cell.x + CARD[0] - 22, y: cell.y - 7, width: 18, height: 14, rx: 7 }), mark(sign, cell.x + CARD[0] - 19, cell.y - 6, sign === "add" ? "on-cut" : "on-bad"));
  box.addEventListener("click", act);
  box.addEventListener("keydown", (key) => {
    if (key.key !== "Enter" && key.key !== " ") return;
    key.preventDefault();
    act();
  });
  boxes.set(key, { box, cell });
  return box;
}

function showState(box, cell, call, isChosen) {
  box.classList.toggle("chosen", isChosen);
  const looks = call ? `${call.state} ${call.attempts} ${call.outcome}` : "step";
  if (box.dataset.looks === looks) return;
  box.dataset.looks = looks;
  const [sign, colour, word] = look(call?.state ?? "waiting");
  if (call) box.dataset.state = call.state;
  box.setAttribute("aria-label", call ? `${call.action}: ${call.outcome}${call.attempts > 1 ? `, attempt ${call.attempts}` : ""}` : `${cell.name} ${cell.what}`);
  const { who, objects } = call ? actionOf(call.action, call.lane) : { who: "", objects: [cell.what] };
  const isOwn = call && call.lane !== call.action.split("(")[0];
  const again = call?.attempts > 1 ? `${call.attempts}× ` : "";
  const declared = call && !["waiting", word, call.state, "running", "aborted"].includes(call.outcome) && call.state === "succeeded" ? call.outcome : "";
  const room = CARD[0] - (cell.reaches_goal ? 30 : 14);
  const said = (most) => again + [isOwn ? who : "", declared || objects.slice(-most).join(" → ")].filter(Boolean).join(" · ");
  const second = widthOf(said(2)) <= room ? said(2) : said(1);
  box.querySelector(".badge").replaceChildren(mark(sign, cell.x + 8, cell.y + 9, colour),
    svg("text", { class: "tn", x: cell.x + 25, y: cell.y + 19 }, fitted(cell.name.replaceAll("_", " "), CARD[0] - 40, true)), svg("text", { class: "td", x: cell.x + 8, y: cell.y + 36 }, fitted(second, room)));
  box.classList.toggle("glow", call?.state === "running");
}

// What a new plan has kept, dropped and added.
function showChanges(replan) {
  const looks = JSON.stringify(replan ?? null);
  if ($("changes").dataset.looks === looks) return;
  $("changes").dataset.looks = looks;
  const part = (colour, sign, word, calls) => (calls.length ? el("span", { class: `pill ${colour}`, title: calls.join("\n") }, el("span", { "aria-hidden": "true" }, sign), `${calls.length} ${word}`) : "");
  $("changes").replaceChildren(...(replan ? [part("dim", "=", "kept", replan.kept), part("bad", "−", "dropped", replan.dropped), part("cut", "+", "added", replan.added)].filter(Boolean) : [el("small", { class: "np" }, "links carry the fact that is waited for"), el("small", { class: "row tight np" }, icon("flag"), "reaches the goal")]));
}

// --- the policy ---

let followed = ""; // what the policy that is shown, or asked for, was made of

// Draws the policy of a run, if it follows one, anew whenever a call of its task has become something else.
export async function showPolicy(model, run, way) {
  const section = $("policy");
  section.hidden = !model.runs.get(run)?.has_policy;
  const made = section.hidden ? "" : JSON.stringify([run, way.map(([key, call]) => [key, call.state, call.outcome])]);
  if (followed === made) return;
  followed = made;
  const text = made && (await fetch(`/policy?run=${run}&at=${model.number}`).then((answer) => (answer.ok ? answer.text() : ""), () => ""));
  if (followed !== made) return; // another one is wanted by now
  const parsed = text && new DOMParser().parseFromString(text, "image/svg+xml").documentElement;
  const picture = parsed && parsed.localName === "svg" && !parsed.querySelector("parsererror") && document.adoptNode(parsed);
  $("policy-said").textContent = picture ? picture.querySelector("title").textContent : "the policy cannot be drawn";
  const area = $("policy-picture");
  area.replaceChildren(...(picture ? [picture] : []));
  const now = area.querySelector(".now circle")?.cy.baseVal.value ?? area.scrollTop;
  const isSeen = now >= area.scrollTop && now <= area.scrollTop + area.clientHeight;
  if (!isSeen && !area.matches(":hover, :focus")) area.scrollTop = now - area.clientHeight / 2; // who looks elsewhere goes on to do so
}
