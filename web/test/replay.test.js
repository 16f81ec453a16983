/** A recorded run in the picture: reading its file, what ends it, and that nothing is approved meanwhile. */
import assert from "node:assert/strict";
import {test} from "node:test";
import * as replay from "../src/panels/replay.js";
import * as runs from "../src/panels/runs.js";
import * as verdict from "../src/panels/verdict.js";
import {curveOf, errorAt, LARGEST, loadReplay, markAt, pathOf, poseAt, readReplay, ReplayError} from "../src/replay/file.js";
import {presentOf} from "../src/replay/present.js";
import {fakePage, plan, view} from "./support/fake.js";
import {textsIn} from "./support/sentences.js";

const JOINTS = ["joint_a1", "joint_a2"];
const mark = (changes) => ({time: 1, source: "gate", state: "IN_SYNC", reason: "", by: "", fault: false, ...changes});

/** A recording of five rows, half a second apart. */
function recorded(changes = {}) {
  return {
    format: "construction_twin replay", version: 1, robot: "kr120", joints: JOINTS, types: ["revolute", "prismatic"], begin: 1790000000,
    period: 0.5, twin: [[0, 0], [100000, 0], [200000, 0], [300000, 0], [400000, 50000]], arm: [null, [90000, 0], [190000, 0], null, [400000, 0]],
    errors: [null, [1000000, 0], [0, 2000000], null, [5000000, 0]], alignment: "by_command",
    marks: [mark({time: 0.5}), mark({time: 1.2, source: "review", state: "approved", by: "ada"}), mark({time: 1.5, state: "HOLDING", reason: "off", fault: true})],
    marks_left_out: 0,
    report: {
      table: [{joint: "joint_a1", average: 1e-5, largest: 2e-5, paper_average: 1.5e-6, paper_largest: 1.7e-6}], duration: 2, samples: 5,
      waypoints: null, lag: null, commands_lost: 0, late_replies: null, round_trip_ms: 23.4, mock: true,
    },
    ...changes,
  };
}

const read = (changes) => readReplay(JSON.stringify(recorded(changes)));

// -- the file

test("poses are looked up between two rows, and where nothing was known there is none", () => {
  const it = read();
  assert.equal(it.duration, 2);
  assert.deepEqual(poseAt(it, "twin", 0.25), [0.5, 0]);
  assert.deepEqual(poseAt(it, "twin", 2), [4, 0.5]);
  assert.deepEqual(poseAt(it, "twin", 99), [4, 0.5]);
  assert.equal(poseAt(it, "arm", 0.2), null);
  assert.deepEqual(poseAt(it, "arm", 1.2), [1.9, 0]);
  assert.equal(poseAt(it, "arm", 1.6), null);
  assert.deepEqual(poseAt(it, "arm", 2), [4, 0]);
});

test("the error is that of the worst joint, in degrees or millimetres, and its curve is broken where none is known", () => {
  const it = read();
  assert.equal(errorAt(it, 0), null);
  assert.equal(errorAt(it, 0.5).joint, "joint_a1");
  assert.ok(Math.abs(errorAt(it, 0.5).value - 0.0573) < 1e-4);
  assert.deepEqual(errorAt(it, 1), {joint: "joint_a2", value: 2, unit: "mm"});
  const curve = curveOf(it, 5);
  assert.ok(Number.isNaN(curve[0]) && Number.isNaN(curve[3]));
  assert.match(pathOf(curve, 10), /^M1 9\.\d+L2 0\.00M4 /);
  assert.equal(pathOf(new Float64Array(3).fill(NaN), 10), "");
  assert.equal(markAt(it, 1.3).source, "review");
  assert.equal(markAt(it, 1.3, "gate").state, "IN_SYNC");
  assert.equal(markAt(it, 0.1), null);
});

const HOSTILE = {
  "no JSON": "{", "another file": "{}", "a list": "[]", "null": "null",
  "another version": JSON.stringify(recorded({version: 2})),
  ...Object.fromEntries(Object.entries({
    robot: 3, joints: ["joint_a1", "joint_a1"], types: ["revolute", "wheel"], begin: 1e300, period: 0, twin: [[0, 0]], arm: [[0, 0]],
    errors: [null, [-1, 0], null, null, null], marks: [mark({fault: "yes"})], alignment: null, marks_left_out: -1, report: {},
  }).map(([name, value]) => [name, JSON.stringify(recorded({[name]: value}))])),
  "a row too short": JSON.stringify(recorded({twin: [[0], [0, 0], [0, 0], [0, 0], [0, 0]]})),
  "a number that is none": JSON.stringify(recorded({twin: [["1", 0], [0, 0], [0, 0], [0, 0], [0, 0]]})),
  "too many rows": JSON.stringify(recorded({twin: Array(20000).fill(null), arm: Array(20000).fill(null), errors: Array(20000).fill(null)})),
  "a joint of the report that is none": JSON.stringify(recorded({report: {...recorded().report, table: [{joint: "x", average: 1, largest: 1, paper_average: null, paper_largest: null}]}})),
  "a text that is too long": JSON.stringify(recorded({marks: [mark({reason: "x".repeat(301)})]})),
};
for (const [what, text] of Object.entries(HOSTILE)) {
  test(`a file that is not a whole recording is refused with a sentence: ${what}`, () => {
    assert.throws(() => readReplay(text), (error) => error instanceof ReplayError && textsIn("de").has(error.key) && textsIn("en")(error.key, error.values) !== "");
  });
}

const body = (...chunks) => new ReadableStream({
  start(controller) {
    for (const chunk of chunks) controller.enqueue(chunk);
    controller.close();
  },
});
const bytes = (text) => new TextEncoder().encode(text);

test("a file is read in pieces, and never beyond the largest one", async () => {
  const whole = bytes(JSON.stringify(recorded({robot: "kr120ü"})));
  const got = await loadReplay("x", async () => ({ok: true, status: 200, body: body(whole.slice(0, 77), whole.slice(77))}));
  assert.equal(got.robot, "kr120ü");
  let given = 0;
  const endless = new ReadableStream({
    pull(controller) {
      given += 2 ** 20;
      controller.enqueue(new Uint8Array(2 ** 20));
    },
  });
  await assert.rejects(loadReplay("x", async () => ({ok: true, status: 200, body: endless})), {key: "replay.too_large"});
  assert.ok(given <= LARGEST + 3 * 2 ** 20);
  for (const [status, key] of [[403, "runs.forbidden"], [404, "replay.gone"], [500, "replay.not_loaded"]]) {
    await assert.rejects(loadReplay("x", async () => ({ok: false, status})), {key});
  }
  await assert.rejects(loadReplay("x", async () => Promise.reject(new TypeError("no network"))), {key: "replay.not_loaded"});
});

// -- the panel

async function page({load = async () => read(), modules = [replay, verdict], ...options} = {}) {
  const fake = fakePage({account: "ada", ...options});
  let frames = [];
  const timers = [];
  const means = {now: () => fake.clock.now, frame: (call) => frames.push(call), every: (ms, call) => timers.push(call), load};
  for (const module of modules) module.make(fake.parent, fake.store, fake.connection, fake.texts, means);
  const settle = () => new Promise((resolve) => setImmediate(resolve));
  const pass = (ms) => {
    fake.later(ms);
    const due = frames;
    frames = [];
    due.forEach((call) => call());
    timers.forEach((call) => call());
  };
  const find = (selector) => fake.parent.querySelector(selector);
  const it = {...fake, settle, pass, find, text: (selector) => find(selector).textContent, replay: () => fake.store.robot("kr120").replay};
  it.begin = async () => {
    it.store.set("replay_run", "kr120", {run: "run1", href: "private/runs/run1/replay.json", report: "private/runs/run1/report.html"});
    await settle();
  };
  await it.hear("kr120", "view", view());
  return it;
}

test("a run is played in the picture, with its time, error, marks and report", async () => {
  const it = await page();
  await it.begin();
  assert.equal(it.find(".replay").hidden, false);
  assert.deepEqual(it.replay().twin, [0, 0]);
  assert.equal(it.replay().arm, null);
  it.click(it.find(".replay-play"));
  for (let k = 0; k < 6; k += 1) it.pass(100);
  assert.ok(Math.abs(it.replay().time - 0.6) < 1e-9);
  assert.ok(Math.abs(it.replay().twin[0] - 1.2) < 1e-9);
  assert.equal(it.replay().sync, "IN_SYNC");
  assert.match(it.text(".replay-mark"), /0\.50 s, monitor: IN_SYNC/);
  it.enter(it.find(".replay-slider"), "1.25");
  assert.match(it.text(".replay-mark"), /verdict: approved by ada/);
  it.click([...it.parent.querySelectorAll("button")].find(({textContent}) => textContent === it.texts("replay.after")));
  assert.equal(it.replay().time, 1.5);
  assert.match(it.text(".replay-mark"), /HOLDING \(off\)/);
  assert.match(it.text(".replay-report"), /joint_a1.*2\.00e-5.*1\.70e-6/);
  assert.match(it.text(".replay-report"), /simulation/);
  assert.equal(it.find(".replay-report a").getAttribute("href"), "private/runs/run1/report.html");
  assert.equal(it.parent.querySelectorAll(".replay-tick").length, 3);
  it.click(it.find(".replay-end"));
  assert.equal(it.replay(), null);
  assert.equal(it.find(".replay").hidden, true);
});

for (const [what, change, word] of [
  ["the arm holds", {sync: {...view().sync, state: "HOLDING", violations: 1}}, "hold"],
  ["the gate is stopped", {sync: {...view().sync, state: "STOPPED"}}, "hold"],
  ["the arm moves", {execution: {...view().execution, state: "PLAYING", plan_id: "p9"}}, "moves"],
  ["the arm is stopped", {execution: {...view().execution, state: "STOPPING", plan_id: "p9"}}, "stop"],
  ["a motion was stopped between two views", {execution: {...view().execution, outcome: "stopped", plan_id: "p9"}}, "stop"],
  ["the view names a plan that waits", {plan: "p1"}, "plan"],
]) {
  test(`a replay ends at once, and says why: ${what}`, async () => {
    const it = await page();
    await it.begin();
    await it.hear("kr120", "view", view());
    assert.notEqual(it.replay(), null);
    await it.hear("kr120", "view", view(change));
    assert.equal(it.replay(), null);
    assert.equal(it.text(".replay-told"), it.texts(`replay.ended.${word}`));
  });
}

test("a plan that comes ends it before its view, and while one waits no recording is shown", async () => {
  const it = await page();
  await it.begin();
  await it.hear("kr120", "plan", plan(), true);
  assert.equal(it.replay(), null);
  await it.begin();
  assert.equal(it.replay(), null);
  assert.equal(it.text(".replay-told"), it.texts("replay.ended.plan"));
});

test("a recording can be looked at while the arm holds; the notice says so, and a hold anew ends it", async () => {
  const it = await page();
  const holding = (violations) => view({sync: {...view().sync, state: "HOLDING", violations}});
  await it.hear("kr120", "view", holding(1));
  await it.begin();
  assert.equal(it.replay().present, "hold");
  await it.hear("kr120", "view", holding(1));
  assert.notEqual(it.replay(), null);
  await it.hear("kr120", "view", holding(2));
  assert.equal(it.replay(), null);
  // and one that is over and comes again
  await it.begin();
  await it.hear("kr120", "view", view());
  assert.equal(it.replay().present, "");
  await it.hear("kr120", "view", holding(2));
  assert.equal(it.replay(), null);
});

test("a lost connection, another robot and a goal that is set end it", async () => {
  for (const [act, word] of [
    [(it) => it.connection.change("lost"), "connection"],
    [async (it) => {
      await it.hear("kr60", "view", view());
      it.store.select("kr60");
    }, "robot"],
    [(it) => it.store.set("goal", "kr120", {names: JOINTS, positions: [1, 2], reach: "free"}), "goal"],
  ]) {
    const it = await page();
    await it.begin();
    await act(it);
    assert.equal(it.replay(), null, word);
    assert.equal(it.text(".replay-told"), it.texts(`replay.ended.${word}`));
  }
});

test("a file that comes when the connection has ended is not shown", async () => {
  let give;
  const it = await page({load: () => new Promise((resolve) => {
    give = resolve;
  })});
  await it.begin();
  it.connection.change("lost");
  give(read());
  await it.settle();
  assert.equal(it.replay(), null);
  assert.equal(it.find(".replay").hidden, true);
});

test("why a run is not shown is said: a broken file, another robot's", async () => {
  const it = await page({load: async () => Promise.reject(new ReplayError("replay.broken", {what: "twin"}))});
  await it.begin();
  assert.match(it.text(".replay-told"), /run1 is not shown: its file is damaged.*twin/);
  const other = await page({load: async () => read({robot: "kr60"})});
  await other.begin();
  assert.match(other.text(".replay-told"), /kr60, which has not been heard/);
});

test("nothing can be approved while a recording is in the picture, whatever was looked at", async () => {
  // only the law of the button: a replay panel would have ended the recording when the plan came
  const it = await page({modules: [verdict]});
  await it.hear("kr120", "view", view({plan: "p1"}));
  await it.hear("kr120", "plan", plan(), true);
  const look = async () => {
    it.later(100);
    await it.hear("kr120", "view", view({plan: "p1"}));
    it.store.set("looked", "kr120", {what: "shown", hash: "h1"});
  };
  it.store.set("looked", "kr120", {what: "checks", hash: "h1"});
  for (let k = 0; k < 12; k += 1) await look();
  assert.equal(it.find(".verdict-approve").disabled, false);
  const press = new it.window.Event("pointerdown", {bubbles: true});
  it.find(".verdict-approve").dispatchEvent(press);
  it.store.set("replay", "kr120", {time: 0});
  assert.equal(it.find(".verdict-approve").disabled, true);
  assert.equal(it.text(".verdict-hint"), it.texts("verdict.blocked.replay"));
  assert.equal(it.text(".verdict-notice"), it.texts("verdict.cancelled.replay"));
  for (let k = 0; k < 15; k += 1) {
    await look();
    it.pass(0);
  }
  assert.equal(it.connection.sent.length, 0);
  it.store.set("replay", "kr120", null);
  assert.equal(it.find(".verdict-approve").disabled, false);
});

test("what the present asks is another thing whenever it has happened anew", () => {
  assert.deepEqual(presentOf(null), {word: "", key: ""});
  const robot = (changes) => ({view: view(changes), plan: null});
  assert.equal(presentOf(robot()).word, "");
  assert.equal(presentOf({view: {...view(), online: false}, plan: null}).word, "");
  const held = (violations) => presentOf(robot({sync: {...view().sync, state: "STALE", violations}})).key;
  assert.notEqual(held(1), held(2));
});

test("the list offers what can be played, and asks for it by the console's own paths", async () => {
  const fake = fakePage();
  const list = {runs: [{name: "a", stamp: 2, report: "a/report.html", replay: "a/replay.json"}, {name: "b", stamp: 1, report: "b/report.html", replay: "../x"}]};
  runs.make(fake.parent, fake.store, fake.connection, fake.texts, {fetch: async () => ({ok: true, status: 200, json: async () => list})});
  await new Promise((resolve) => setImmediate(resolve));
  const asked = [];
  fake.store.on("replay_run", (robot, value) => asked.push(value));
  const play = [...fake.parent.querySelectorAll("td button")];
  assert.equal(play.length, 1);
  fake.click(play[0]);
  assert.equal(fake.parent.querySelector(".runs-told").textContent, fake.texts("runs.no_robot"));
  await fake.hear("kr120", "view", view());
  fake.click(play[0]);
  assert.deepEqual(asked, [{run: "a", href: "private/runs/a/replay.json", report: "private/runs/a/report.html"}]);
});
