import assert from "node:assert/strict";
import {mock, test} from "node:test";
import {makeCell} from "../src/picture/cell.js";
import {BY_TASK} from "../src/picture/colours.js";
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

/** A building model with one element, as its file says of which model it is. */
const building = (hash) => JSON.stringify({
  asset: {version: "2.0", ...(hash === null ? {} : {extras: {model_hash: hash}})}, scene: 0, scenes: [{nodes: [0]}],
  nodes: [{name: "beam", extras: {element: "beam"}}],
});
/** Reading a model takes a few turns. */
async function loaded(it, condition) {
  for (let k = 0; k < 200 && !condition(it.made.inspect()); k += 1) await it.settle();
  return it.made.inspect();
}

test("a building model of another hash than the tasks' is not shown, is said, and is fetched again", async () => {
  mock.timers.enable({apis: ["setTimeout"]});
  for (const other of ["old", null]) {
    const it = cell({"robot.urdf": 404, "building.glb": building(other)});
    await it.hear("kr120", "work/tasks", work({model_hash: "new"}), true);
    assert.equal((await loaded(it, ({stale}) => stale)).stale, true);
    assert.deepEqual(it.made.inspect().elements, []);
    it.answers["building.glb"] = building("new");
    mock.timers.tick(5000);
    const {elements, stale} = await loaded(it, (found) => found.elements.length);
    assert.deepEqual([elements.map(([element]) => element), stale], [["beam"], false]);
  }
  mock.timers.reset();
});

test("a model that is shown goes when the tasks are of another one, and no task colours it meanwhile", async () => {
  const it = cell({"robot.urdf": 404, "building.glb": building("one")});
  await it.hear("kr120", "work/tasks", work({model_hash: "one"}), true);
  assert.equal((await loaded(it, ({elements}) => elements.length)).elements[0][1], BY_TASK.ready[0]);
  it.answers["building.glb"] = building("two");
  await it.hear("kr120", "work/tasks", work({model_hash: "two", tasks: [{...work().tasks[0], state: "done"}]}), true);
  assert.deepEqual(it.made.inspect().elements, []);
  assert.equal((await loaded(it, ({elements}) => elements.length)).elements[0][1], BY_TASK.done[0]);
  // while the robot's program reads its model again there are no tasks of it
  await it.hear("kr120", "work/tasks", work({model_hash: "", tasks: [], reason: "the model is being read"}), true);
  assert.deepEqual(it.made.inspect().elements, []);
});
