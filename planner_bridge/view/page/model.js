// The state that is shown: parts with things by key, as the server tells them. A frame changes it.

export const PARTS = ["tasks", "runs", "calls", "requests", "facts", "servers", "questions", "hands", "troubles", "events"];

export function nothing() {
  const model = { number: 0, time: 0, began: 0, first: 0, problem: "", clock: null, journal: "", heard: null };
  for (const part of PARTS) model[part] = new Map();
  return model;
}

// Returns the model after a frame, and the names of the parts that it has changed.
export function applied(model, frame) {
  const next = frame.is_whole ? nothing() : model;
  for (const name of ["number", "time", "began", "first", "problem", "clock", "journal"]) next[name] = frame[name];
  next.heard = { at: performance.now(), isWhole: frame.is_whole };
  for (const [part, things] of Object.entries(frame.parts)) {
    for (const [key, thing] of Object.entries(things)) {
      if (thing === null) next[part].delete(key);
      else next[part].set(key, thing);
    }
  }
  return [next, frame.is_whole ? PARTS : Object.keys(frame.parts)];
}

// Returns the time on the clock of the records now: it goes on while nothing is recorded.
export function timeNow(model) {
  if (!model.heard) return model.time;
  const since = (performance.now() - model.heard.at) / 1000;
  const now = model.heard.isWhole && model.clock !== null ? Date.now() / 1000 - model.clock : model.time + since;
  return Math.max(model.time, now);
}
