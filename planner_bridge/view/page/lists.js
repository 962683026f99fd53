// Knowledge, servers and events, as lists.

import { KNOWN, MARKS, el, placed, seconds } from "./words.js";

// Elements of things by key, made anew only where the thing is another one: it is never changed, but replaced.
class Kept {
  #made = new Map();

  all(entries, make) {
    const old = this.#made;
    this.#made = new Map(entries.map(([key, thing]) => [key, old.get(key)?.thing === thing ? old.get(key) : { thing, element: make(key, thing) }]));
    return [...this.#made.values()].map((each) => each.element);
  }
}

const rowOf = new Kept();
const lineOf = new Kept();
const SHOWN = 100;
let factRows = null;

export function showFacts(model) {
  const wanted = document.getElementById("fact-filter").value.trim().toLowerCase().split(/\s+/);
  const all = document.getElementById("fact-false").checked;
  const shown = [...model.facts.entries()]
    .filter(([name, fact]) => (all || fact.value !== "false") && wanted.every((word) => name.toLowerCase().includes(word)))
    .sort(([, a], [, b]) => b.since - a.since);
  const isStale = (fact) => fact.source === "sensed" && fact.value === "unknown"; // nothing reports it any more
  const rows = rowOf.all(shown, (name, fact) => el("tr", { "data-fact": name, class: isStale(fact) ? "stale" : "" },
    el("td", {}, name),
    el("td", {}, fact.value, fact.was ? el("span", { class: "soft" }, ` (was ${fact.was})`) : ""),
    el("td", { class: "num" }, isStale(fact) ? "◍ stale" : KNOWN[fact.source]),
    el("td", { class: "num" }, fact.is_initial ? "beginning" : seconds(fact.since - model.began))));
  const head = el("tr", {}, ...["fact", "value", "known by", "since"].map((text) => el("th", { scope: "col" }, text)));
  if (!factRows) document.getElementById("facts").replaceChildren(el("thead", {}, head), (factRows = el("tbody")));
  placed(factRows, rows);
}

export function showServers(model) {
  const rows = [...model.servers.entries()].map(([name, server]) => el("tr", { "data-server": name },
    el("td", {}, name, server.actions.length > 1 || !name.endsWith(server.actions[0]) ? el("span", { class: "soft" }, ` ${server.actions.join(", ")}`) : ""),
    el("td", {}, server.busy.length ? `▶ ${server.busy.join(", ")}` : "idle"),
    el("td", { class: "num" }, server.failed ? `✕ ${server.failed}` : "")));
  const head = el("tr", {}, ...["server", "busy with", "failed"].map((text) => el("th", { scope: "col" }, text)));
  document.getElementById("server-list").replaceChildren(el("thead", {}, head), el("tbody", {}, ...rows));
}

export function showEvents(model, go) {
  const list = document.getElementById("event-list");
  const shown = [...model.events.entries()].map(([number, event]) => [Number(number), event]).filter(([number]) => number > model.number - SHOWN);
  shown.sort(([a], [b]) => b - a);
  placed(list, lineOf.all(shown, (number, event) => {
    const link = el("a", { href: `#${number}`, title: "show what was so after this record" }, String(number));
    link.addEventListener("click", (click) => {
      click.preventDefault();
      go(number);
    });
    const sign = event.mark ? `${MARKS[event.mark]} ` : "";
    return el("li", { class: event.mark ? "marked" : "", "data-record": number },
      link, el("span", { class: "num soft" }, seconds(event.time - model.began)), el("span", { class: "lines" }, sign + event.lines.join("\n")));
  }));
}
