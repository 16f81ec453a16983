import assert from "node:assert/strict";
import {readFileSync} from "node:fs";
import {test} from "node:test";
import {BY_SYNC, BY_TASK} from "../src/picture/colours.js";

test("the states of a task that have a colour are those that the robot's program has", () => {
  const source = readFileSync(new URL("../../src/construction_twin/extensions/work/task_memory.py", import.meta.url), "utf8");
  const [, rows] = /class TaskState\(.*?\):([\s\S]*?)\nclass /.exec(source);
  const states = [...rows.matchAll(/^ {4}[A-Z]+ = "(\w+)"$/gm)].map(([, word]) => word);
  assert.ok(states.length > 10);
  assert.deepEqual(Object.keys(BY_TASK).sort(), states.sort());
});

test("a word from the broker finds a colour or nothing", () => {
  for (const table of [BY_SYNC, BY_TASK]) for (const word of ["constructor", "toString", "__proto__"]) assert.equal(table[word], undefined);
});
