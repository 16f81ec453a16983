import assert from "node:assert/strict";
import {mock, test} from "node:test";
import {makeCell} from "../src/picture/cell.js";
import {fakePage, view, work} from "./support/fake.js";

/** A cell whose files the test answers: `answers` by the end of the path, a status or a text; `asked` holds the paths. */
function cell(answers) {
  const asked = [];
  const page = fakePage();
  globalThis.location = new URL("http://127.0.0.1:8480/");
  globalThis.fetch = async (address) => {
    asked.push(address.pathname);
    const [, found = 404] = Object.entries(answers).find(([end]) => address.pathname.endsWith(end)) ?? [];
    return {ok: typeof found === "string", status: found, text: async () => found, arrayBuffer: async () => new TextEncoder().encode(found).buffer};
  };
  const overlay = page.document.createElement("div");
  overlay.getRootNode = () => page.document;
  overlay.setPointerCapture = () => {};
  page.parent.append(overlay);
  const made = makeCell("kr120", overlay, page.store, () => {});
  const settle = () => new Promise((resolve) => setImmediate(resolve));
  return {...page, made, asked, answers, settle};
}

test("a robot model that cannot be had is asked for every five seconds, and not with each of 25 views a second", async () => {
  mock.timers.enable({apis: ["setTimeout"]});
  const it = cell({"robot.urdf": 403});
  for (let k = 0; k < 100; k += 1) {
    await it.hear("kr120", "view", view());
    await it.settle();
    await it.settle();
  }
  assert.deepEqual(it.asked, ["/private/kr120/robot.urdf"]);
  assert.match(it.made.state.failed, /403/);
  mock.timers.tick(5000);
  await it.settle();
  assert.equal(it.asked.length, 2);
  mock.timers.reset();
});

test("a building model that could not be had is asked for again", async () => {
  mock.timers.enable({apis: ["setTimeout"]});
  const it = cell({"robot.urdf": 404, "building.glb": 404});
  const tasks = work({model_hash: "0"});
  await it.hear("kr120", "work/tasks", tasks, true);
  await it.settle();
  const models = () => it.asked.filter((path) => path.endsWith("building.glb")).length;
  await it.hear("kr120", "work/tasks", tasks, true);
  await it.settle();
  assert.equal(models(), 1);
  assert.match(it.made.state.lacks, /404/);
  mock.timers.tick(5000);
  await it.settle();
  assert.equal(models(), 2);
  // without tasks nobody looks at it
  await it.hear("kr120", "work/tasks", null, true);
  mock.timers.tick(5000);
  await it.settle();
  assert.equal(models(), 2);
  mock.timers.reset();
});
