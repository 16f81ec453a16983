// The tasks of a building model, as a person reads them. Pure.
import {mark} from "../texts.js";

export const GROUPS = {
  waits: mark("waits"), ready: mark("ready"), asked: mark("plan waits for approval"), moves: mark("in work"), done: mark("done"),
  skipped: mark("skipped"), person: mark("needs a person"),
};
// The states of docs/reference/states.md, with what they mean for somebody who looks at a list.
const BY_STATE = {
  waiting: "waits", ready: "ready", carried: "ready", planned: "asked", working: "moves", gripping: "moves", carrying: "moves",
  releasing: "moves", retreating: "moves", done: "done", skipped: "skipped", asks: "person", held: "person",
};
const ASKABLE = new Set(["ready", "carried"]);

// One of "waits", "ready", "asked", "moves", "done", "skipped", "person"; "unknown" for a state of another version.
export function group(state) {
  return Object.hasOwn(BY_STATE, state) ? BY_STATE[state] : "unknown";
}

const isOver = (task) => ["done", "skipped"].includes(group(task.state));

// Whether a plan of the task can be asked for now.
export function isAskable(work, task) {
  return !work.engaged && ASKABLE.has(task.state);
}

// {done, all}: skipped tasks count as done with.
export function counts(work) {
  return {done: work.tasks.filter(isOver).length, all: work.tasks.length};
}

export function nextTask(work) {
  return work.tasks.find((task) => task.id === work.next) ?? null;
}

// The task of an element that was tapped: the one that is not over yet, else the last one; null when it has none.
export function taskOfElement(work, element) {
  const tasks = work.tasks.filter((task) => task.element === element);
  return tasks.find((task) => !isOver(task)) ?? tasks.at(-1) ?? null;
}

// The state by which an element is coloured: that of this task, but what was placed stands, whatever task on it still
// waits or was skipped; undefined when it has none.
export function stateOfElement(work, element) {
  const state = taskOfElement(work, element)?.state;
  const stands = work.tasks.some((task) => task.element === element && task.state === "done");
  return stands && (state === "waiting" || state === "skipped") ? "done" : state;
}

// Names of the tasks that must be over before this one, and are not.
export function waitsFor(work, task) {
  const byId = new Map(work.tasks.map((one) => [one.id, one]));
  return task.after.map((id) => byId.get(id)).filter((one) => one && !isOver(one)).map((one) => one.name);
}
