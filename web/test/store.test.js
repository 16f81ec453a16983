import assert from "node:assert/strict";
import {test} from "node:test";
import {makeStore} from "../src/store.js";
import {fakePage, plan, view, work} from "./support/fake.js";

test("a robot that is heard is there and the first one is selected", async () => {
  const {store, hear} = fakePage();
  const names = [];
  store.on("robots", (_, value) => names.push(value));
  await hear("b", "view", view());
  await hear("a", "view", view());
  assert.deepEqual(names, [["b"], ["a", "b"]]);
  assert.equal(store.selected, "b");
  assert.equal(store.robot("a").view.run, "run");
  assert.equal(store.robot("c"), null);
});

test("a view with a lower number of the same run is an old one", async () => {
  const {store, hear} = fakePage();
  const first = view();
  const second = view();
  await hear("r", "view", second);
  await hear("r", "view", first);
  assert.equal(store.robot("r").view.seq, second.seq);
  await hear("r", "view", {...first, run: "another"});
  assert.equal(store.robot("r").view.run, "another");
});

test("the moment that requests repeat is that of the newest view; without one there is none", async () => {
  const {store, hear, connection} = fakePage();
  assert.equal(store.moment("r"), "");
  await hear("r", "view", view({moment: "c0ffee00-1"}));
  await hear("r", "view", view({moment: "c0ffee00-2"}));
  assert.equal(store.moment("r"), "c0ffee00-2");
  await hear("r", "view", {...view({moment: "c0ffee00-1"}), seq: 1});
  assert.equal(store.moment("r"), "c0ffee00-2", "an older one does not count");
  connection.change("lost");
  assert.equal(store.moment("r"), "");
});

test("what is not as expected is refused, counted and told, and the last value stays", async () => {
  const {store, hear} = fakePage();
  const told = [];
  store.on("refused", (robot, value) => told.push([robot, value.kind]));
  const good = view();
  await hear("r", "view", good);
  await hear("r", "view", view({version: 9}));
  await hear("r", "view", view({moment: undefined}));
  await hear("r", "view", view({twin: {positions: [1]}}));
  await hear("r", "view", view({expected: {stamp: 1, age: 0, positions: [1]}}));
  await store.take("r", "view", "{");
  await store.take("r", "screen", "3");
  await store.take("r", "scene", "{}");
  await store.take("r", "stop/ack", "[]");
  assert.deepEqual(told.map(([, kind]) => kind), ["view", "view", "view", "view", "view", "screen", "scene", "stop_ack"]);
  assert.equal(store.refused, 8);
  assert.equal(store.robot("r").view.seq, good.seq);
});

test("a view is old after a second without another, and at once when the sender is offline", async () => {
  const {store, hear, later} = fakePage();
  const told = [];
  store.on("old", (_, value) => told.push(value));
  await hear("r", "view", view());
  later(900);
  later(200);
  await hear("r", "view", view());
  await hear("r", "view", view({online: false, seq: 0, twin: null, arm: null, sync: null, link: null, execution: null}));
  assert.deepEqual(told, [false, true, false, true]);
});

test("a lost connection makes everything unknown until it is heard anew", async () => {
  const {store, hear, connection} = fakePage();
  await hear("r", "view", view());
  await hear("r", "plan", plan());
  await hear("r", "screen", [{topic: "sync", state: "IN_SYNC", sentence: "ok"}]);
  connection.change("lost", "closed");
  for (const kind of ["view", "plan", "screen"]) assert.equal(store.robot("r")[kind], null);
  assert.equal(store.robot("r").old, true);
  connection.change("connected");
  assert.equal(store.robot("r").plan, null);
  await hear("r", "plan", plan(), true);
  assert.equal(store.robot("r").plan.id, "p1");
});

test("a plan counts only once its hash was checked, and the one before is gone at once", async () => {
  const answers = [];
  const store = makeStore({now: () => 0, check: (each) => new Promise((resolve) => answers.push(() => resolve({...each, refused: ""})))});
  const take = (value) => store.take("r", "plan", JSON.stringify(value));
  const first = take(plan());
  assert.equal(store.robot("r").plan, null);
  answers[0]();
  await first;
  assert.equal(store.robot("r").plan.id, "p1");
  const second = take(plan({id: "p2"}));
  assert.equal(store.robot("r").plan, null);
  const third = take(plan({id: "p3"}));
  answers[2]();
  answers[1]();
  await Promise.all([second, third]);
  assert.equal(store.robot("r").plan.id, "p3");
});

test("a plan that is taken away, or is none, leaves nothing under review", async () => {
  const {store, hear} = fakePage();
  await hear("r", "plan", plan());
  await hear("r", "plan", null);
  assert.equal(store.robot("r").plan, null);
  await hear("r", "plan", plan());
  await hear("r", "plan", {id: "p2"});
  assert.equal(store.robot("r").plan, null);
});

test("a stored answer or view is of unknown age and does not count", async () => {
  const {store, hear} = fakePage();
  const acks = [];
  store.on("stop_ack", (_, value) => acks.push(value));
  await hear("r", "stop/ack", {id: "1"}, true);
  await hear("r", "view", view(), true);
  assert.deepEqual(acks, []);
  assert.equal(store.robot("r"), null);
  await hear("r", "stop/ack", {id: "1"});
  assert.deepEqual(acks, [{id: "1"}]);
});

test("names in topics cannot fill the page", async () => {
  const {store, hear} = fakePage();
  for (let k = 0; k < 100; k += 1) await hear(`robot${k}`, "view", view());
  assert.equal(store.robots.length, 32);
});

test("what a panel sets reaches the others and stays for those that look later", async () => {
  const {store, hear} = fakePage();
  await hear("r", "view", view());
  const told = [];
  store.on("playback", (robot, value) => told.push([robot, value.time]));
  store.set("playback", "r", {names: ["joint_a1"], positions: [0], time: 1.5});
  store.set("playback", "nobody", {time: 2});
  assert.deepEqual(told, [["r", 1.5]]);
  assert.equal(store.robot("r").playback.time, 1.5);
});

test("a view whose joints are of no known type is refused: what is drawn and plotted depends on it", async () => {
  const {store, hear} = fakePage();
  const names = ["joint_a1", "joint_a2"];
  for (const types of [undefined, null, "revolute", [], ["revolute"], ["revolute", "screw"], ["revolute", 1], ["revolute", "revolute", "revolute"]]) {
    await hear("r", "view", view({joints: {names, types}}));
    assert.equal(store.robot("r").view, null, String(types));
  }
  assert.equal(store.refused, 8);
  await hear("r", "view", view({joints: {names, types: ["prismatic", "revolute"]}}));
  assert.deepEqual(store.robot("r").view.joints.types, ["prismatic", "revolute"]);
});

test("tasks that are none are refused with a sentence, and the last ones stay", async () => {
  const {store, hear} = fakePage();
  const told = [];
  store.on("refused", (_, {kind, sentence}) => told.push([kind, sentence]));
  await hear("r", "work/tasks", work(), true);
  const [task] = work().tasks;
  const bad = [
    {}, work({tasks: null}), work({tasks: {}}), work({tasks: [null]}), work({tasks: [{...task, name: 3}]}), work({tasks: [{...task, after: "1"}]}),
    work({tasks: [{...task, deviation_deg: "1"}]}), work({tasks: [{...task, answers: "yes"}]}), work({tasks: [{...task, question: {}}]}),
    work({model_hash: undefined}), work({engaged: "no"}), work({reason: null}), work({notes: "none"}), work({notes: [1]}),
  ];
  for (const value of bad) await hear("r", "work/tasks", value, true);
  assert.equal(told.length, bad.length);
  for (const [kind, sentence] of told) assert.match(`${kind}: ${sentence}`, /^tasks: .*task/);
  assert.equal(store.robot("r").tasks.model, "wall.ifc");
  await hear("r", "work/tasks", null);
  assert.equal(store.robot("r").tasks, null);
});

const ANSWERS = ["review/ack", "stop/ack", "pause/ack", "plan_request/ack"];

/** Hear messages of a topic, of which each must be refused, and told in a sentence that is no exception's own. */
async function refuses({store, hear}, topic, values) {
  const told = [];
  const end = store.on("refused", (_, {sentence}) => told.push(sentence));
  for (const value of values) {
    const before = told.length;
    await hear("r", topic, value, topic === "plan");
    assert.equal(told.length, before + 1, JSON.stringify(value));
    assert.doesNotMatch(told.at(-1), /undefined|reading|is not a function/);
  }
  end();
}

test("a status line that is none is refused, and the last one stays", async () => {
  const page = fakePage();
  await page.hear("r", "view", view());
  const line = {topic: "sync", state: "IN_SYNC", sentence: "Twin and arm agree."};
  await page.hear("r", "screen", [line]);
  await refuses(page, "screen", [
    null, 3, "lines", true, {}, {lines: 3}, {lines: null}, {lines: [3]}, [null], [3], [[]], ["a"], [line, null], [{...line, topic: undefined}],
    [{...line, sentence: undefined}], [{...line, topic: 3}], [{...line, sentence: null}], [{...line, sentence: ["a"]}], [line, {}],
  ]);
  assert.deepEqual(page.store.robot("r").screen, [line]);
});

test("a plan whose form is not a plan's is refused, and then none is under review", async () => {
  const bad = [
    3, "p1", true, [], [plan()], {}, plan({id: undefined}), plan({id: ""}), plan({id: 1}), plan({id: null}), plan({hash: undefined}),
    plan({hash: 1}), plan({hash: null}), plan({joints: undefined}), plan({joints: null}), plan({joints: "joint_a1"}), plan({joints: {}}),
    plan({joints: [1]}), plan({duration: "1"}), plan({clearance: {}}), plan({use: {velocity: []}}), plan({goal: null}), plan({tool_path: [0]}),
    plan({trajectory: 7}), plan({segments: [{name: "go"}]}), plan({content: {}}),
  ];
  for (const value of bad) {
    const page = fakePage();
    await page.hear("r", "plan", plan(), true);
    assert.equal(page.store.robot("r").plan.id, "p1");
    await refuses(page, "plan", [value]);
    assert.equal(page.store.robot("r").plan, null, JSON.stringify(value));
  }
});

test("an answer that is no object, or of which a field is of another type, is refused and reaches nobody", async () => {
  const page = fakePage();
  const told = [];
  for (const kind of ["review_ack", "stop_ack", "pause_ack", "plan_request_ack"]) page.store.on(kind, (_, value) => told.push([kind, value]));
  const [review, stop, pause, request] = ANSWERS;
  for (const topic of ANSWERS) await refuses(page, topic, [null, 3, "yes", true, [], [{id: "1", ok: true}]]);
  for (const topic of [stop, pause, request]) await refuses(page, topic, [{id: 1}, {id: null}]);
  for (const topic of [review, stop, pause, request]) await refuses(page, topic, [{ok: 1}, {ok: "yes"}, {reason: null}, {account: 1}]);
  await refuses(page, review, [{verdict: true}, {plan_id: null}, {plan_hash: 1}, {reviewer: []}]);
  await refuses(page, request, [{duration: "2"}, {plan_id: 1}, {expired: 1}]);
  assert.deepEqual(told, []);
});
