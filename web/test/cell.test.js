import assert from "node:assert/strict";
import {mock, test} from "node:test";
import {makeCell} from "../src/picture/cell.js";
import {Box3, Vector3} from "three";
import {AHEAD, BY_TASK, GOAL, TRAVELLED} from "../src/picture/colours.js";
import {loadMesh} from "../src/picture/robot_model.js";
import {fakePage, plan, view, work} from "./support/fake.js";

/** A cell whose files the test answers: `answers` by the end of the path, a status or a text; `asked` holds the paths. */
function cell(answers) {
  const asked = [];
  const page = fakePage();
  globalThis.location = new URL("https://twin.cell/cell1/?theme=dark");
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
  return {...page, overlay, made, asked, answers, settle};
}

test("a robot model that cannot be had is asked for every five seconds, and not with each of 25 views a second", async () => {
  mock.timers.enable({apis: ["setTimeout"]});
  const it = cell({"robot.urdf": 403});
  for (let k = 0; k < 100; k += 1) {
    await it.hear("kr120", "view", view());
    await it.settle();
    await it.settle();
  }
  assert.deepEqual(it.asked, ["/cell1/private/kr120/robot.urdf"]);
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
/** Reading a model takes a few turns, and its reader is loaded first. */
async function loaded(it, condition) {
  for (const end = Date.now() + 10_000; !condition(it.made.inspect()) && Date.now() < end;) await it.settle();
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

// -- with a robot

/** An arm of two joints without files: a post, 1 m high, and two beams of 1 m; the tool at the end of the second. */
const ROBOT = `<robot name="two"><material name="orange"><color rgba="1 0.4 0.05 1"/></material>${
  [["base", "0 0 0.5", "0.2 0.2 1"], ["upper", "0.5 0 0", "1 0.1 0.1"], ["lower", "0.5 0 0", "1 0.1 0.1"]].map(([name, at, size]) => `
  <link name="${name}"><visual><origin xyz="${at}"/><geometry><box size="${size}"/></geometry><material name="orange"/></visual></link>`).join("")}
  <link name="tool0"/>${
  [["joint_a1", "revolute", "base", "upper", "0 0 1"], ["joint_a2", "revolute", "upper", "lower", "1 0 0"], ["flange", "fixed", "lower", "tool0", "1 0 0"]]
    .map(([name, type, parent, child, at]) => `<joint name="${name}" type="${type}"><parent link="${parent}"/><child link="${child}"/>
  <origin xyz="${at}"/><axis xyz="0 -1 0"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>`).join("")}</robot>`;

async function robotCell(options = {}, before = async () => {}) {
  const it = cell({"robot.urdf": ROBOT, ...options});
  await before(it);
  await it.hear("kr120", "view", view({twin: {stamp: 1, age: 0, positions: [0, 0]}, arm: {stamp: 1, age: 0, positions: [0, 0]}}));
  for (const end = Date.now() + 10_000; !it.made.ready && Date.now() < end;) await it.settle();
  assert.equal(it.made.ready, true, it.made.state.failed);
  it.made.resize(800, 500);
  return it;
}

/** The robot above, one of whose boxes is drawn by the file of this name. */
const withMeshes = (...names) => names.reduce((text, name) => text.replace(/<box size="[^"]+"\/>/, `<mesh filename="../mesh/${name}"/>`), ROBOT);
const OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";

test("OBJ and GLB meshes are drawn, and one that cannot be read costs that link and is said", async () => {
  const glb = JSON.stringify({asset: {version: "2.0"}, scene: 0, scenes: [{nodes: [0]}], nodes: [{name: "empty"}]});
  const it = await robotCell({"robot.urdf": withMeshes("a.obj", "b.glb"), "a.obj": OBJ, "b.glb": glb});
  assert.equal(it.made.state.unread, "");
  const lacking = await robotCell({"robot.urdf": withMeshes("a.obj", "b.glb", "c.dae"), "a.obj": OBJ, "b.glb": "no GLB", "c.dae": 404});
  for (const why of [/b\.glb: /, /c\.dae: 404/]) assert.match(lacking.made.state.unread, why);
  const none = cell({"robot.urdf": withMeshes("b.glb"), "b.glb": "no GLB"});
  await none.hear("kr120", "view", view());
  for (const end = Date.now() + 10_000; !none.made.state.failed && Date.now() < end;) await none.settle();
  assert.notEqual(none.made.state.failed, "", "an arm without any mesh is none");
});

/** A tetrahedron of 0.2, 0.4 and 0.95 m in files of several formats, units and up axes. */
const CORNERS = [0, 0, 0, 0.2, 0, 0, 0, 0.4, 0, 0, 0, 0.95];
const FACES = [0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3];
const scaled = (factor) => CORNERS.map((value) => value * factor);
const triples = (values) => [0, 3, 6, 9].map((k) => values.slice(k, k + 3));

const collada = (metres, axis) => `<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="u" meter="${metres}"/><up_axis>${axis}</up_axis></asset><library_geometries><geometry id="g"><mesh><source id="p">
<float_array id="a" count="12">${scaled(1 / metres).join(" ")}</float_array><technique_common><accessor source="#a" count="4" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices><triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/>
<p>${FACES.join(" ")}</p></triangles></mesh></geometry></library_geometries><library_visual_scenes><visual_scene id="s"><node id="n">
<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>`;

/** A binary glTF in mm, whose root node makes metres of it. */
function glbInMillimetres() {
  const data = Buffer.concat([Buffer.from(Float32Array.from(scaled(1000)).buffer), Buffer.from(Uint16Array.from(FACES).buffer)]);
  const about = JSON.stringify({
    asset: {version: "2.0"}, scene: 0, scenes: [{nodes: [0]}], nodes: [{children: [1], scale: [0.001, 0.001, 0.001]}, {mesh: 0}],
    meshes: [{primitives: [{attributes: {POSITION: 0}, indices: 1}]}], buffers: [{byteLength: data.length}],
    bufferViews: [{buffer: 0, byteLength: 48}, {buffer: 0, byteOffset: 48, byteLength: 24}],
    accessors: [{bufferView: 0, componentType: 5126, count: 4, type: "VEC3", min: [0, 0, 0], max: [200, 400, 950]},
      {bufferView: 1, componentType: 5123, count: 12, type: "SCALAR"}],
  });
  const text = Buffer.from(about.padEnd(4 * Math.ceil(about.length / 4)));
  const chunk = (kind, bytes) => [Buffer.from(Uint32Array.of(bytes.length, kind).buffer), bytes];
  const all = Buffer.concat([...chunk(0x4E4F534A, text), ...chunk(0x004E4942, data)]);
  return Buffer.concat([Buffer.from(Uint32Array.of(0x46546C67, 2, 12 + all.length).buffer), all]);
}

test("a mesh is drawn in the same size from every format, unit and up axis", async () => {
  const facets = triples(FACES).map((face) => face.map((k) => `vertex ${triples(CORNERS)[k].join(" ")}`).join("\n"));
  const files = {
    "a.stl": `solid a\n${facets.map((corners) => `facet normal 0 0 1\nouter loop\n${corners}\nendloop\nendfacet`).join("\n")}\nendsolid a\n`,
    "a.OBJ": [...triples(CORNERS).map((corner) => `v ${corner.join(" ")}`), ...triples(FACES).map((face) => `f ${face.map((k) => k + 1).join(" ")}`)].join("\n"),
    "cm.dae": collada(0.01, "Z_UP"), "mm.dae": collada(0.001, "Y_UP"), "inch.dae": collada(0.0254, "X_UP"), "mm.glb": glbInMillimetres(),
  };
  globalThis.location = new URL("https://twin.cell/cell1/");
  for (const [name, contents] of Object.entries(files)) {
    globalThis.fetch = async () => ({ok: true, arrayBuffer: async () => Uint8Array.from(Buffer.from(contents)).buffer});
    const size = new Box3().setFromObject(await loadMesh(`https://twin.cell/cell1/private/mesh/${name}`, null)).getSize(new Vector3());
    size.toArray().forEach((value, k) => assert.ok(Math.abs(value - [0.2, 0.4, 0.95][k]) < 1e-6, `${name}: ${size.toArray()}`));
  }
});

const NAMES = ["joint_a1", "joint_a2"];
const TELLS = {
  goal: (it) => it.store.set("goal", "kr120", {names: NAMES, positions: [0.5, 0.5]}),
  plan: (it) => it.hear("kr120", "plan", plan({joints: NAMES, goal: [1, 0], start: [0, 0], tool_path: [[2, 0, 1], [2, 0.2, 1]],
    trajectory: {times: [0, 1], positions: [[0, 0], [1, 0]], velocities: [[0, 0], [0, 0]], accelerations: [[0, 0], [0, 0]]}}), true),
  view: (it) => it.hear("kr120", "view", view({twin: {stamp: 1, age: 0, positions: [0.1, 0]}, arm: null})),
};
const orders = (rest) => (rest.length < 2 ? [rest] : rest.flatMap((one) => orders(rest.filter((each) => each !== one)).map((more) => [one, ...more])));

test("the goal of a person is drawn in place of the plan's, whatever is told first, before the model or after it", async () => {
  for (const order of orders(Object.keys(TELLS))) {
    const tell = async (cellOf, kinds) => {
      for (const what of kinds) await TELLS[what](cellOf);
    };
    const early = order.indexOf("view");
    const it = await robotCell({}, async (cellOf) => {
      await cellOf.hear("kr120", "work/tasks", null, true);
      await tell(cellOf, order.slice(0, early));
    });
    await tell(it, order.slice(early));
    assert.deepEqual([it.made.inspect().goal.joints.joint_a1, it.made.drawn().goal], [0.5, GOAL], `${order}`);
    it.store.set("goal", "kr120", null);
    assert.equal(it.made.inspect().goal.joints.joint_a1, 1);
  }
});

test("the legend names the twin in its colour, and the arm beside it only where it is beside it", async () => {
  const it = await robotCell();
  assert.deepEqual([it.made.drawn().both, it.made.drawn().twin, it.made.drawn().arm], [0xff660d, null, null]);
  const beside = (state, arm) => it.hear("kr120", "view", view({
    sync: {...view().sync, state}, twin: {stamp: 1, age: 0, positions: [0, 0]}, arm: arm && {stamp: 1, age: 0, positions: arm}}));
  await beside("IN_SYNC", [0.01, 0]);
  assert.deepEqual([it.made.drawn().both, it.made.drawn().twin, it.made.drawn().arm], [null, 0xff660d, 0x1abf40]);
  // a gate that holds is seen by its colour, also where both are in the same place
  await beside("HOLDING", [0, 0]);
  assert.deepEqual([it.made.drawn().both, it.made.drawn().twin, it.made.drawn().arm], [null, 0xff660d, 0xffcc00]);
  await beside("IN_SYNC", null);
  assert.deepEqual([it.made.drawn().both, it.made.drawn().twin, it.made.drawn().arm], [null, 0xff660d, null]);
});

test("the axes of the tool stand at the twin's tool and turn with it", async () => {
  const it = await robotCell();
  const {frame, twin} = it.made.inspect();
  frame.position.forEach((value, k) => assert.ok(Math.abs(value - twin.tool[k]) < 1e-9));
  assert.ok(frame.axes[0][0] > 0.99 && frame.axes[2][2] > 0.99);
  await it.hear("kr120", "view", view({twin: {stamp: 1, age: 0, positions: [0, Math.PI / 2]}}));
  // about minus y: x goes up
  assert.ok(it.made.inspect().frame.axes[0][2] > 0.99);
});

/** Where a point is in the picture: inside is from -1 to 1. */
async function projected(it, point) {
  const {Vector3} = await import("three");
  it.made.camera.updateMatrixWorld();
  const {x, y} = new Vector3(...point).project(it.made.camera);
  return Math.max(Math.abs(x), Math.abs(y));
}
const wall = (x) => ({hash: String(x), frame: "base_link", padding: 0, objects: [{
  name: "wall", shape: "box", size: [0.1, 1, 1], position: [x, 0, 0.5], orientation: [0, 0, 0, 1], link: "", mesh: "", padding: 0, touch: []}]});

test("the camera is fitted to arm, scene and plan, until a person moves it; a press on the button fits it again", async () => {
  const it = await robotCell();
  assert.ok(await projected(it, it.made.inspect().twin.tool) < 1);
  const close = it.made.inspect().camera.position;
  await it.hear("kr120", "scene", wall(-2.1), true);
  assert.ok(await projected(it, [-2.1, 0.5, 1]) <= 1);
  assert.notDeepEqual(it.made.inspect().camera.position, close);
  // the tool leaves what was fitted to
  await it.hear("kr120", "view", view({twin: {stamp: 1, age: 0, positions: [-1.5, 0]}}));
  assert.ok(await projected(it, it.made.inspect().twin.tool) <= 1);
  // a person takes hold of it
  it.overlay.dispatchEvent(Object.assign(new it.window.Event("pointerdown"), {pointerId: 1, button: 0, clientX: 5, clientY: 5, pointerType: "mouse"}));
  const {camera: held} = it.made.inspect();
  assert.equal(held.chosen, "");
  await it.hear("kr120", "scene", wall(2.1), true);
  await TELLS.plan(it);
  it.made.resize(400, 500);
  assert.deepEqual(it.made.inspect().camera, held);
  it.made.look("home");
  assert.ok(await projected(it, [2.1, 0.5, 1]) <= 1);
});

test("the closest point is the plan's, with its distance in the picture", async () => {
  const it = await robotCell();
  await it.hear("kr120", "plan", plan({clearance: {distance: 0.2, time: 0.5, between: ["lower", "wall"], point: [1, 0, 1]}}), true);
  assert.deepEqual([it.made.inspect().closest.distance, it.made.inspect().closest.time], [0.2, 0.5]);
  assert.ok(it.made.labels(800, 500).some(({text}) => text === "200 mm"));
  await it.hear("kr120", "plan", null, true);
  assert.equal(it.made.inspect().closest, null);
});

test("a path has a dot at each waypoint", async () => {
  const it = await robotCell();
  const points = Array.from({length: 12}, (_, k) => [1.5, k / 12 - 0.5, 1]);
  await it.hear("kr120", "plan", plan({joints: NAMES, tool_path: points, waypoints: 12}), true);
  assert.equal(it.made.inspect().waypoints, 12);
});

test("the scene's floor is the floor of the picture and is not drawn as a body", async () => {
  const it = await robotCell();
  const floor = {...wall(0).objects[0], name: "hall", size: [20, 20, 1], position: [0, 0, -0.8]};
  await it.hear("kr120", "scene", {...wall(-1), objects: [floor, ...wall(-1).objects]}, true);
  const found = it.made.inspect();
  assert.ok(Math.abs(found.floor.height + 0.3) < 1e-9);
  assert.deepEqual(found.objects, ["hall", "wall"]);
  assert.notEqual(it.made.drawn().standing, null);
  await it.hear("kr120", "scene", {...wall(-2), objects: [floor]}, true);
  assert.equal(it.made.drawn().standing, null);
});

test("while a plan is played its path is there, travelled apart from ahead, with the time that is left; then it goes", async () => {
  const it = await robotCell();
  const path = {plan_id: "p1", times: [0, 1, 2], tool_path: [[2, 0, 1], [1.6, 0.4, 1], [1.2, 0.8, 1]]};
  const says = (state, progress, more = {}) => it.hear("kr120", "view", view({
    twin: {stamp: 1, age: 0, positions: [progress, 0]}, execution: {...view().execution, state, plan_id: "p1", duration: 2, progress, rate: 1}, ...more}));
  const left = () => it.made.labels(800, 500).filter(({kind}) => kind === "left").map(({text}) => text);
  // whoever comes in mid motion is told one or the other first
  await says("PLAYING", 0.25);
  assert.deepEqual([it.made.inspect().played, it.made.drawn().ahead, it.made.drawn().travelled, left()], [null, null, null, []]);
  await it.hear("kr120", "path", path, true);
  assert.deepEqual(it.made.inspect().played.travelled, [[2, 0, 1], [1.8, 0.2, 1]]);
  await says("PLAYING", 0.75);
  assert.deepEqual(it.made.inspect().played.ahead, [[1.4, 0.6000000000000001, 1], [1.2, 0.8, 1]]);
  assert.deepEqual([it.made.drawn().ahead, it.made.drawn().travelled, left()], [AHEAD, TRAVELLED, ["0:01"]]);
  await says("PAUSED", 0.75);
  assert.deepEqual([it.made.drawn().travelled, left()], [TRAVELLED, []], "who stands still has no time left that could be told");
  await says("IDLE", 1);
  assert.deepEqual([it.made.inspect().played, it.made.drawn().ahead, it.made.drawn().travelled], [null, null, null]);
});
