// The state that is shown: parts with things by key, as the server tells them. A frame changes it.

const PARTS = ["tasks", "runs", "calls", "requests", "facts", "servers", "questions", "troubles", "events"];

export function nothing() {
  const model = { number: 0, time: 0, began: 0, first: 0, problem: "", journal: "" };
  for (const part of PARTS) model[part] = new Map();
  return model;
}

// Returns the model after a frame, and the names of the parts that it has changed.
export function applied(model, frame) {
  const next = frame.is_whole ? nothing() : model;
  for (const name of ["number", "time", "began", "first", "problem", "journal"]) next[name] = frame[name];
  for (const [part, things] of Object.entries(frame.parts)) {
    for (const [key, thing] of Object.entries(things)) {
      if (thing === null) next[part].delete(key);
      else next[part].set(key, thing);
    }
  }
  return [next, frame.is_whole ? PARTS : Object.keys(frame.parts)];
}
