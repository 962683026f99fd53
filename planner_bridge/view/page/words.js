// Words and signs for what is shown, and small makers of elements.

// By state: the icon, the colour and the word.
export const STATES = {
  waiting: ["wait", "dim", "waiting"], running: ["run", "run", "running"], suspended: ["pause", "dim", "suspended"], handed_over: ["fwd", "dim", "goes on in the next plan"],
  succeeded: ["ok", "ok", "done"], already_true: ["eq", "ok", "not needed"], skipped: ["drop", "dim", "skipped"], canceled: ["bad", "dim", "cancelled"],
  unconfirmed: ["ask", "ask", "unconfirmed"], passed_over: ["fwd", "dim", "passed over"], failed: ["bad", "bad", "failed"], asks: ["ask", "ask", "asks you"],
  queued: ["wait", "dim", "queued"], planning: ["cut", "cut", "planning"], replanning: ["cut", "cut", "looks for a new plan"], pausing: ["pause", "dim", "pausing"],
  paused: ["pause", "dim", "paused"], cancelling: ["bad", "dim", "cancelling"], goal_reached: ["ok", "ok", "goal reached"], cancelled: ["bad", "dim", "cancelled"],
};
export const MARKS = { failure: ["bad", "failed"], replan: ["cut", "new plan"], end: ["ok", "ended"] };
export const DONE = new Set(["succeeded", "already_true"]);
export const KNOWN = { sensed: "◉ sensed", assumed: "◌ assumed" };

export const look = (name) => STATES[name] ?? ["bad", "bad", words(name)];

export function words(name) {
  return name.replaceAll("_", " ");
}

export const counted = (count, what) => `${count} ${what}${count === 1 ? "" : "s"}`;

export function seconds(time, digits = 0) {
  return `${time.toFixed(digits)} s`;
}

// A length of time, as short as it can be said.
export function span(time) {
  const whole = Math.max(0, Math.round(time));
  if (whole < 100) return `${whole} s`;
  if (whole < 3600) return whole % 60 && whole < 600 ? `${Math.floor(whole / 60)} min ${whole % 60} s` : `${Math.round(whole / 60)} min`;
  const minutes = Math.round(whole / 60);
  return `${Math.floor(minutes / 60)} h${minutes % 60 ? ` ${minutes % 60} min` : ""}`;
}

// A number of a fact, with no more places than anybody reads.
export function figure(text) {
  return /^-?\d+\.\d{4,}$/.test(text) ? String(Number(Number(text).toPrecision(3))) : text;
}

const two = (number) => String(number).padStart(2, "0");

export function clock(wall, hasSeconds = true) {
  const day = new Date(wall * 1000);
  return `${two(day.getHours())}:${two(day.getMinutes())}${hasSeconds ? `:${two(day.getSeconds())}` : ""}`;
}

// The time of day of a moment on the clock of the records; seconds since the beginning, if that is not known.
export function tod(model, time, hasSeconds = true) {
  return model.clock === null ? seconds(time - model.began, time - model.began < 100 ? 1 : 0) : clock(model.clock + time, hasSeconds);
}

// --- facts in words: (at parcel1 hall) is "parcel1 at hall" ---

function parsed(text) {
  const marks = text.match(/[()]|[^\s()]+/g) ?? [];
  let at = 0;
  const one = () => {
    if (marks[at] !== "(") return marks[at++];
    const list = [];
    for (at += 1; at < marks.length && marks[at] !== ")"; ) list.push(one());
    at += 1;
    return list;
  };
  const tree = one();
  return at === marks.length ? tree : null;
}

const COMPARED = { ">": ">", "<": "<", ">=": "≥", "<=": "≤", "=": "=" };

function said(tree) {
  if (!Array.isArray(tree)) return words(tree ?? "");
  const [name, ...args] = tree;
  if (Array.isArray(name) || name === undefined) return tree.map(said).join(" ");
  if (name === "and") return args.map(said).join(", ");
  if (name === "or") return args.map(said).join(" or ");
  if (name in COMPARED && args.length === 2) return `${said(args[0])} ${COMPARED[name]} ${said(args[1])}`;
  if (name === "not" && args.length === 1 && Array.isArray(args[0]) && !["and", "or", "not", "forall", "exists"].includes(args[0][0])) {
    const [fact, first, ...rest] = args[0];
    return [first && said(first), "not", words(fact), ...rest.map(said)].filter(Boolean).join(" ");
  }
  if (["not", "imply", "forall", "exists", "when"].includes(name) || /^[-+*/]$/.test(name)) return `${words(name)} ${args.map(said).join(" ")}`;
  const [first, ...rest] = args;
  return [first && said(first), words(name), ...rest.map(said)].filter(Boolean).join(" ");
}

const told = new Map();

export function inWords(text) {
  if (!text.startsWith("(")) return text;
  if (!told.has(text)) {
    if (told.size > 5000) told.clear();
    const tree = parsed(text);
    told.set(text, tree ? said(tree) : text);
  }
  return told.get(text);
}

// The name of an action, who acts, and on what: "move(r1, hall, kitchen)".
const actions = new Map();

export function actionOf(text, lane = "") {
  const key = `${lane} ${text}`;
  if (actions.size > 20000) actions.clear();
  if (!actions.has(key)) actions.set(key, split(text, lane));
  return actions.get(key);
}

function split(text, lane) {
  const [, name, list] = /^([^(]*)\((.*)\)$/s.exec(text) ?? [null, text, ""];
  const others = list ? list.split(", ") : [];
  return { name: words(name), who: lane, objects: others[0] === lane ? others.slice(1) : others };
}

// The state of a request, in the words of calls.
export function stateOf(request, isOver) {
  if (!request.outcome) return isOver ? "unconfirmed" : "running";
  return request.outcome === "succeeded" ? "succeeded" : request.outcome === "canceled" ? "canceled" : "failed";
}

// --- elements ---

export function el(name, attributes = {}, ...children) {
  return filled(document.createElement(name), attributes, children);
}

export function svg(name, attributes = {}, ...children) {
  return filled(document.createElementNS("http://www.w3.org/2000/svg", name), attributes, children);
}

function filled(element, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (value !== null && value !== undefined && value !== false) element.setAttribute(name, value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined && child !== ""));
  return element;
}

export function icon(name, colour = "") {
  return svg("svg", { class: `i ${colour}`, "aria-hidden": "true" }, svg("use", { href: `#i-${name}` }));
}

// An icon in a picture.
export function mark(name, x, y, colour, size = 12) {
  return svg("svg", { x, y, width: size, height: size, viewBox: "0 0 16 16", class: `i ${colour}`, "aria-hidden": "true" }, svg("use", { href: `#i-${name}` }));
}

export function pill(colour, name, text) {
  return el("span", { class: `pill ${colour}` }, icon(name), text);
}

export function statePill(name, text) {
  const [sign, colour, word] = look(name);
  return el("span", { class: `pill state ${colour}`, "data-state": name }, icon(sign), text ?? word);
}

export function button(text, title, act, look = "btn") {
  const made = el("button", { type: "button", class: look, title }, ...(Array.isArray(text) ? text : [text]));
  made.addEventListener("click", act);
  return made;
}

export function signButton(name, label, title, act) {
  const made = button([icon(name)], title, act, "btn ico");
  made.setAttribute("aria-label", label);
  return made;
}

const ruler = document.createElement("canvas").getContext("2d");
const widths = new Map();
let family = ""; // asked for once: to ask while a frame is drawn has the browser work out the styles of the whole page

// The width of a text of the smallest size in a picture.
export function widthOf(text, isBold = false) {
  const key = `${isBold ? "b" : ""}${text}`;
  if (!widths.has(key)) {
    if (widths.size > 5000) widths.clear();
    family ||= getComputedStyle(document.body).fontFamily;
    ruler.font = `${isBold ? 600 : 400} 12px ${family}`;
    widths.set(key, ruler.measureText(text).width);
  }
  return widths.get(key);
}

export const whole = (text, width, isBold) => (widthOf(text, isBold) <= width ? text : "");

export function fitted(text, width, isBold) {
  if (widthOf(text, isBold) <= width) return text;
  let letters = Math.min(text.length, Math.floor(width / 4));
  while (letters > 1 && widthOf(`${text.slice(0, letters).trimEnd()}…`, isBold) > width) letters -= 1;
  return letters > 1 ? `${text.slice(0, letters).trimEnd()}…` : "";
}

// Has a place hold these elements in this order; those that are where they belong are not touched.
export function placed(place, elements) {
  let next = place.firstChild;
  for (const element of elements) {
    if (element === next) next = next.nextSibling;
    else place.insertBefore(element, next);
  }
  while (next) {
    const last = next;
    next = next.nextSibling;
    last.remove();
  }
}

const kept = new WeakMap();

// Has a place hold an element for each entry [key, looks, attributes, children]; it is filled anew only if it looks other than before.
export function keyed(place, tag, entries, act) {
  const old = kept.get(place) ?? new Map();
  const next = new Map(entries.map(([key, looks, attributes, children]) => {
    const known = old.get(key) ?? { element: el(tag, tag === "button" ? { type: "button" } : {}) };
    if (!old.has(key) && act) known.element.addEventListener("click", () => act(key));
    if (known.looks !== looks) {
      for (const { name } of [...known.element.attributes]) if ((attributes[name] ?? null) === null && name !== "type") known.element.removeAttribute(name);
      known.element.replaceChildren();
      filled(known.element, attributes, children());
      known.looks = looks;
    }
    return [key, known];
  }));
  kept.set(place, next);
  placed(place, [...next.values()].map((each) => each.element));
}

// Draws something whose elements may be put in again: the one that has the focus keeps it.
export function keepingFocus(draw) {
  const focused = document.activeElement;
  draw();
  if (focused?.isConnected && focused !== document.activeElement && focused !== document.body) focused.focus({ preventScroll: true });
}

// Answers to the question why, as trees.
export function reasons(answers) {
  return el("ul", { class: "why" }, ...answers.map((answer) => el("li", {}, answer.statement,
    answer.known && answer.known !== "given" ? el("span", { class: "dim" }, ` [${answer.known}]`) : "", answer.reasons.length ? reasons(answer.reasons) : "")));
}
