// The plan of a run: the picture that the server draws, with the state of each call by colour and sign.

import { SIGNS, el, svg, words } from "./words.js";

let drawn = "";
let drawing = ""; // what is fetched
let boxes = new Map();
let keys = new Map(); // of calls, by their numbers
let shown = new Map(); // the calls as they were shown last
let marked = ""; // the call that is shown as the chosen one
const KEY = ["waiting", "running", "succeeded", "failed", "skipped"];

document.getElementById("plan-key").replaceChildren(...KEY.map((name) => el("span", {}, el("span", { class: "swatch", "data-state": name }, SIGNS[name]), words(name === "succeeded" ? "done" : name))));

// Draws the plan of a run if it is another one than before; the picture of a run never changes.
export async function showPlan(model, run, choose) {
  const place = document.getElementById("picture");
  if (!run) {
    drawn = "";
    boxes = new Map();
    place.replaceChildren(el("p", { class: "soft" }, "no plan yet"));
    return;
  }
  if (drawn === run) drawing = "";
  else if (drawing !== run) {
    drawing = run;
    const text = await fetch(`/picture?run=${run}&at=${model.number}`).then((answer) => (answer.ok ? answer.text() : ""), () => "");
    if (drawing !== run) return; // another one is wanted by now
    drawing = "";
    if (!text) return;
    const picture = new DOMParser().parseFromString(text, "image/svg+xml").documentElement;
    picture.style.minWidth = `${Math.min(Number(picture.getAttribute("width")), 1000)}px`; // smaller than that, nobody can read it
    picture.dataset.run = run;
    picture.setAttribute("role", "group"); // its calls are buttons, which no image has
    drawn = run;
    boxes = new Map([...picture.querySelectorAll("[data-step]")].map((box) => [Number(box.dataset.step), box]));
    keys = new Map([...boxes.keys()].map((index) => [index, `${run}/${index}`]));
    shown = new Map();
    marked = "";
    for (const [index, box] of boxes) {
      box.setAttribute("tabindex", "0");
      box.setAttribute("role", "button");
      box.addEventListener("click", () => choose(`${run}/${index}`));
      box.addEventListener("keydown", (key) => {
        if (key.key === "Enter" || key.key === " ") {
          key.preventDefault();
          choose(`${run}/${index}`);
        }
      });
    }
    const drawable = picture.localName === "svg" && !picture.querySelector("parsererror");
    const why = drawable ? "nothing is to be done: the plan has no calls" : "the picture of the plan cannot be drawn by this browser";
    place.replaceChildren(drawable && boxes.size ? document.adoptNode(picture) : el("p", { class: "soft" }, why));
  }
}

let followed = ""; // what the policy that is shown, or asked for, was made of

// Draws the policy of a run, if it follows one, anew whenever a call of its task has become something else.
export async function showPolicy(model, run) {
  const whole = document.getElementById("policy");
  whole.hidden = !model.runs.get(run)?.has_policy;
  const runs = [...model.tasks.values()].find((task) => task.runs.includes(run))?.runs ?? [run];
  const calls = [...model.calls].filter(([, call]) => runs.includes(call.run)).map(([key, call]) => [key, call.state, call.outcome]);
  const made = whole.hidden ? "" : JSON.stringify([run, calls]);
  if (followed === made) return;
  followed = made;
  const text = made && (await fetch(`/policy?run=${run}&at=${model.number}`).then((answer) => (answer.ok ? answer.text() : ""), () => ""));
  if (followed !== made) return; // another one is wanted by now
  const parsed = text && new DOMParser().parseFromString(text, "image/svg+xml").documentElement;
  const picture = parsed && parsed.localName === "svg" && !parsed.querySelector("parsererror") && document.adoptNode(parsed);
  document.getElementById("policy-said").textContent = picture ? picture.querySelector("title").textContent : "the policy cannot be drawn";
  const place = document.getElementById("policy-picture");
  place.replaceChildren(...(picture ? [picture] : []));
  const now = place.querySelector(".now circle")?.cy.baseVal.value ?? place.scrollTop;
  const isSeen = now >= place.scrollTop && now <= place.scrollTop + place.clientHeight;
  if (!isSeen && !place.matches(":hover, :focus")) place.scrollTop = now - place.clientHeight / 2; // who looks elsewhere goes on to do so
}

const boxOf = (run, key) => (key.startsWith(`${run}/`) ? boxes.get(Number(key.slice(run.length + 1))) : undefined);

function badgeOf(box) {
  const rect = box.querySelector("rect");
  const [x, y] = [Number(rect.getAttribute("x")) + 12, Number(rect.getAttribute("y")) - 3]; // beside the facts that arrows bring, not on them
  const badge = svg("g", { class: "badge", "aria-hidden": "true" }, svg("circle", { cx: x, cy: y, r: 9 }), svg("text", { x, y: y + 4 }), svg("text", { x: x + 22, y: y - 4 }));
  box.append(badge);
  return badge;
}

// Shows the states of calls: of those that are other ones than when they were shown last.
export function showStates(model, run, chosen) {
  if (drawn !== run) return; // its picture is still to come
  if (marked !== chosen) {
    boxOf(run, marked)?.classList.remove("chosen");
    boxOf(run, chosen)?.classList.add("chosen");
    marked = chosen;
  }
  for (const [index, box] of boxes) {
    const call = model.calls.get(keys.get(index));
    if (!call || shown.get(index) === call) continue;
    const before = shown.get(index);
    shown.set(index, call);
    box.setAttribute("aria-label", `${call.action}: ${call.outcome}${call.attempts > 1 ? `, attempt ${call.attempts}` : ""}`);
    if (before?.state === call.state && before.attempts === call.attempts) continue;
    box.dataset.state = call.state;
    const badge = box.querySelector(".badge") ?? badgeOf(box);
    badge.children[1].textContent = SIGNS[call.state] ?? "·";
    badge.children[2].textContent = call.attempts > 1 ? `${call.attempts}×` : "";
  }
}
