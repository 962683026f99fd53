// Words and signs for what is shown, and small makers of elements.

export const SIGNS = {
  waiting: "○", running: "▶", suspended: "‖", handed_over: "⇥", succeeded: "✓", already_true: "≡", skipped: "–",
  canceled: "⊘", unconfirmed: "?", passed_over: "↷", failed: "✕",
};
export const MARKS = { failure: "✕", replan: "↻", end: "■" };

export const KNOWN = { sensed: "◉ sensed", assumed: "◌ assumed" };

export function seconds(time, digits = 2) {
  return `${time.toFixed(digits)} s`;
}

export function clock(wall) {
  return new Date(wall * 1000).toLocaleTimeString();
}

export function words(name) {
  return name.replaceAll("_", " ");
}

// The state of a request, in the words of calls.
export function stateOf(request, isOver) {
  if (!request.outcome) return isOver ? "unconfirmed" : "running";
  return request.outcome === "succeeded" ? "succeeded" : request.outcome === "canceled" ? "canceled" : "failed";
}

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
  element.append(...children.filter((child) => child !== null && child !== ""));
  return element;
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

export function state(name, text = words(name)) {
  const sign = SIGNS[name];
  return el("span", { class: "state", "data-state": name }, sign ? `${sign} ${text}` : text);
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
    answer.known && answer.known !== "given" ? el("span", { class: "soft" }, ` [${answer.known}]`) : "", answer.reasons.length ? reasons(answer.reasons) : "")));
}
