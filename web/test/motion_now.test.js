/** Where the arm is and how far the plan has come: numbers for people, and the panels that show them. */
import assert from "node:assert/strict";
import {readFileSync} from "node:fs";
import {test} from "node:test";
import * as motion from "../src/panels/motion.js";
import * as progress from "../src/panels/progress.js";
import {makeToolFields, textsOf} from "../src/panels/tool_fields.js";
import * as waypoints from "../src/panels/waypoints.js";
import {fromAngles, shownAngle, toAngles} from "../src/planning/angles.js";
import {axesOf, valueOf} from "../src/planning/axes.js";
import {numberOf} from "../src/planning/joints.js";
import {readModels, shortNames} from "../src/planning/model.js";
import {MOST, waypointsOf} from "../src/planning/waypoints.js";
import {clock, percentOf, progressOf} from "../src/progress.js";
import {fakePage, plan, view} from "./support/fake.js";
import {textsIn} from "./support/sentences.js";

const URDF = readFileSync(new URL("support/track.urdf", import.meta.url), "utf8");
const near = (found, wanted, within = 1e-6) => assert.ok(Math.abs(found - wanted) < within, `${found} is not ${wanted}`);

// -- orientations

/** Rotate a vector by a quaternion, written anew: the test shall not trust the code's own. */
function rotated([x, y, z, w], [px, py, pz]) {
  const matrix = [
    [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
    [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
    [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
  ];
  return matrix.map(([a, b, c]) => a * px + b * py + c * pz);
}

test("A, B, C turn about Z, then the new Y, then the newest X, as KUKA's controllers do", () => {
  const turn = (degrees) => [Math.cos((degrees * Math.PI) / 180), Math.sin((degrees * Math.PI) / 180)];
  const [ca, sa] = turn(30);
  const [cb, sb] = turn(20);
  const [cc, sc] = turn(-50);
  // the columns of Rz(30) Ry(20) Rx(-50), multiplied out
  const columns = [
    [ca * cb, sa * cb, -sb],
    [ca * sb * sc - sa * cc, sa * sb * sc + ca * cc, cb * sc],
    [ca * sb * cc + sa * sc, sa * sb * cc - ca * sc, cb * cc],
  ];
  const quaternion = fromAngles({a: 30, b: 20, c: -50});
  [[1, 0, 0], [0, 1, 0], [0, 0, 1]].forEach((axis, k) => rotated(quaternion, axis).forEach((value, row) => near(value, columns[k][row])));
});

test("angles there and back are the same orientation, upright too", () => {
  for (const a of [-179, -90, 0, 33, 180]) {
    for (const b of [-90, -89.9, -30, 0, 45, 90]) {
      for (const c of [-180, -20, 0, 100]) {
        const given = fromAngles({a, b, c});
        const again = fromAngles(toAngles(given));
        near(Math.abs(given.reduce((sum, part, k) => sum + part * again[k], 0)), 1, 1e-7);
      }
    }
  }
  assert.deepEqual(toAngles(fromAngles({a: 10, b: 90, c: 0})).c, 0);
  assert.deepEqual([-0.001, -179.999, 180, -12.345].map(shownAngle), ["0.00", "180.00", "180.00", "-12.35"]);
});

// -- joints

test("joints are read without what all of them begin with", () => {
  assert.deepEqual(shortNames(["joint_a1", "joint_a2"]), ["a1", "a2"]);
  assert.deepEqual(shortNames(["kr_joint_a1", "kr_joint_b2"]), ["a1", "b2"]);
  assert.deepEqual(shortNames(["track", "joint_a1"]), ["track", "joint_a1"]);
  assert.deepEqual(shortNames(["joint_a1"]), ["joint_a1"]);
});

test("each joint has its place in its limits, its values and whether its difference is allowed", () => {
  const joints = [{name: "joint_a1", type: "revolute", lower: -1, upper: 1}, {name: "joint_a2", type: "prismatic", lower: 0, upper: 2}];
  const now = view({
    joints: {names: ["joint_a1", "joint_a2"], types: ["revolute", "prismatic"]},
    twin: {stamp: 1, age: 0, positions: [0.5, 0.5]}, arm: {stamp: 1, age: 0, positions: [-3, 0.501]},
    expected: {stamp: 1, age: 0, positions: [0, 0.5005]},
    sync: {...view().sync, error: [0.02, 0.0005], threshold: [0.01, 0.001]},
  });
  const [first, second] = axesOf(now, joints);
  assert.deepEqual([first.unit, first.twin, first.expected, first.at, first.isOver], ["°", "28.65", "0.00", {twin: 0.75, arm: 0, expected: 0.5}, true]);
  assert.deepEqual([second.unit, second.arm, second.expected, second.difference, second.allowed, second.isOver], ["mm", "501.0", "500.5", "0.5", "1.0", false]);
  // nothing is guessed
  const [unknown] = axesOf(view({twin: null, sync: null}), null);
  assert.deepEqual([unknown.twin, unknown.expected, unknown.difference, unknown.allowed, unknown.isOver, unknown.at], ["", "", "", "", false, {twin: null, arm: null, expected: null}]);
  assert.equal(valueOf(joints[0], -1e-9), "0.00");
});

// -- progress

test("what remains is told at the speed that the plan goes to, and not while it stands", () => {
  const execution = {...view().execution, state: "PLAYING", plan_id: "p1", duration: 40, progress: 0.25, rate: 0.02, speed_limit: 0.5};
  assert.deepEqual(progressOf(execution), {id: "p1", progress: 0.25, left: 30, remaining: 60, speed: 0.02, limit: 0.5, segment: null});
  assert.equal(progressOf({...execution, speed_limit: 1}).remaining, 30);
  for (const state of ["PAUSED", "HELD", "STOPPING", "AT_BOUNDARY"]) assert.equal(progressOf({...execution, state}).remaining, null);
  assert.equal(progressOf({...execution, speed_limit: 0}).remaining, null);
  for (const none of [null, {...execution, state: "IDLE"}, {...execution, state: "of a later version"}]) assert.equal(progressOf(none), null);
});

test("seconds and percents are those that people read", () => {
  assert.deepEqual([0, 6.2, 59.99, 60, 83, 3600].map(clock), ["0:00", "0:07", "1:00", "1:00", "1:23", "60:00"]);
  assert.deepEqual([0, 0.001, 0.5, 0.999, 1].map(percentOf), [0, 1, 50, 99, 100]);
});

test("of a plan's waypoints a person gets every second or tenth, and the last", () => {
  const of = (count) => plan({trajectory: {times: Array.from({length: count}, (_, k) => k / 10), positions: Array.from({length: count}, (_, k) => [k / count])}});
  assert.equal(waypointsOf(of(MOST), ["revolute"]).rows.length, MOST);
  for (const count of [2, 17, 100, 5001]) {
    const {rows, step, all} = waypointsOf(of(count), ["revolute"]);
    assert.ok(rows.length <= MOST + 1 && all === count);
    assert.deepEqual([rows[0][0], rows.at(-1)[0]], ["0.00", ((count - 1) / 10).toFixed(2)]);
    assert.equal(Number(rows[1][0]).toFixed(1), (Math.min(step, count - 1) / 10).toFixed(1));
  }
});

// -- panels

/** A panel with a timer that the test calls: `tick()`. */
function panel(module, {fetchText = async () => URDF, ...options} = {}, means = {}) {
  const timers = [];
  const page = fakePage({account: "ada", ...options});
  module.make(page.parent, page.store, page.connection, page.texts, {now: () => 0, every: (_, call) => timers.push(call), ...means});
  readModels(page.store, page.connection, fetchText);
  const text = (selector) => page.parent.querySelector(selector).textContent;
  return {...page, text, tick: () => timers.forEach((call) => call()), find: (selector) => page.parent.querySelector(selector)};
}
const playing = (changes = {}) => view({
  execution: {...view().execution, state: "PLAYING", plan_id: "p1", duration: 40, progress: 0.25, rate: 1, speed_limit: 1, ...changes},
});

test("while a plan is played its name, progress, rest and speed are there, and afterwards nothing", async () => {
  const it = panel(progress);
  await it.hear("kr120", "view", view());
  it.tick();
  assert.equal(it.find(".progress").hidden, true);
  await it.hear("kr120", "plan", plan({source: "Pia"}), true);
  await it.hear("kr120", "plan", null, true);
  await it.hear("kr120", "view", playing());
  it.tick();
  assert.equal(it.find(".progress").hidden, false);
  assert.equal(it.text(".progress-name"), "Plan by Pia");
  assert.equal(it.find(".progress-bar").getAttribute("aria-valuenow"), "25");
  assert.equal(it.text(".progress-left"), "0:30 left");
  assert.equal(it.text(".progress-speed"), "speed 100 %, limit 100 %");
  await it.hear("kr120", "view", playing({segment: {number: 1, name: "carry", at_boundary: false}, state: "PAUSED", rate: 0}));
  it.tick();
  assert.equal(it.text(".progress-name"), "Plan by Pia, segment 2: carry");
  assert.equal(it.text(".progress-left"), "stands, 0:30 of the plan left");
  await it.hear("kr120", "view", view());
  it.tick();
  assert.equal(it.find(".progress").hidden, true);
});

test("a plan that this page has never seen is told by its id, and nothing is shown between two ticks", async () => {
  const it = panel(progress, {language: "de"});
  await it.hear("kr120", "view", playing({plan_id: "0123456789ab"}));
  it.tick();
  assert.equal(it.text(".progress-name"), "Plan 01234567");
  await it.hear("kr120", "view", playing({progress: 0.5}));
  assert.equal(it.text(".progress-percent"), "25 %");
  it.tick();
  assert.equal(it.text(".progress-percent"), "50 %");
});

const NAMES = ["track", "joint_a1", "joint_a2", "joint_a3", "joint_a4", "joint_a5", "joint_a6"];
const JOINTS = {names: NAMES, types: ["prismatic", ...Array(6).fill("revolute")]};
const standing = (changes = {}) => view({
  joints: JOINTS, twin: {stamp: 1, age: 0, positions: [1, 0, -1.5, 1.5, 0, 1.5, 0]}, arm: {stamp: 1, age: 0, positions: [1, 0, -1.5, 1.5, 0, 1.5, 0.1]},
  sync: {...view().sync, error: [0, 0, 0, 0, 0, 0, 0.1], threshold: Array(7).fill(0.02)}, ...changes,
});
/** Let a fetch and what waits for it end. */
const settle = () => new Promise((resolve) => setTimeout(resolve));

test("joints, limits, difference and tool are shown with the robot's model", async () => {
  const it = panel(motion);
  await it.hear("kr120", "view", standing());
  await settle();
  it.tick();
  const rows = [...it.parent.querySelectorAll(".motion-row")].slice(1);
  assert.equal(rows.length, 7);
  assert.equal(rows[1].querySelector(".motion-end").textContent, "-185");
  assert.equal(rows[0].querySelector(".motion-twin").textContent, "1000.0 mm");
  assert.deepEqual(rows.map((row) => row.classList.contains("is-over")), [...Array(6).fill(false), true]);
  assert.equal(rows[6].querySelector(".motion-difference").textContent, "5.73° over 1.15°");
  assert.match(it.text(".motion-tool-name"), /tool0 in track_base/);
  assert.match(it.text(".motion-tool dl"), /X-?\d+\.\d mm/);
  assert.equal(it.find(".motion-axes").getAttribute("role"), "table");
});

test("where the servos should have the arm is shown while that is known", async () => {
  const it = panel(motion);
  const marks = () => [...it.parent.querySelectorAll(".motion-at-expected")].map(({hidden}) => hidden);
  await it.hear("kr120", "view", standing());
  await settle();
  it.tick();
  assert.equal(it.find(".motion").classList.contains("has-expected"), false);
  assert.deepEqual(marks(), Array(7).fill(true));
  await it.hear("kr120", "view", standing({expected: {stamp: 1, age: 0, positions: [1.0005, 0, -1.5, 1.5, 0, 1.5, 0.08]}}));
  it.tick();
  assert.equal(it.find(".motion").classList.contains("has-expected"), true);
  assert.deepEqual([...it.parent.querySelectorAll(".motion-row:not(.motion-head) .motion-expected")].map(({textContent}) => textContent).filter((_, k) => k % 6 === 0), ["1000.5 mm", "4.58°"]);
  assert.deepEqual(marks(), Array(7).fill(false));
  // the gate does not know any more what the arm is told
  await it.hear("kr120", "view", standing());
  it.tick();
  assert.equal(it.find(".motion").classList.contains("has-expected"), false);
});

test("the curve has the largest difference of the last minute, and what is allowed", async () => {
  const clock = {at: 0};
  const it = panel(motion, {}, {now: () => clock.at});
  const hear = async (at, error) => {
    clock.at = at;
    await it.hear("kr120", "view", standing({sync: {...view().sync, error: [0, 0, 0, 0, 0, 0, error], threshold: Array(7).fill(0.02)}}));
    it.tick();
    return it.text(".motion-curve figcaption");
  };
  const heights = () => it.find(".motion-curve polyline").getAttribute("points").split(" ").map((point) => Number(point.split(",")[1]));
  assert.match(await hear(0, -0.03), /150 % now, 150 % at most/);
  // of one step the largest stays
  assert.match(await hear(100, 0.01), /150 % now/);
  assert.match(await hear(30000, 0.01), /50 % now, 150 % at most/);
  assert.deepEqual(heights(), [0.091, 0.697]);
  assert.match(await hear(60000, 0), /0 % now, 50 % at most/);
  clock.at = 70000;
  await it.hear("kr120", "view", standing({sync: null}));
  it.tick();
  assert.match(it.text(".motion-curve figcaption"), /– now, 50 % at most/);
});

test("mode and override are shown where the controller sends them, else that it does not", async () => {
  for (const [language, not, unknown] of [["en", "not sent", "not known"], ["de", "nicht gesendet", "nicht bekannt"]]) {
    const it = panel(motion, {language});
    const facts = () => [...it.parent.querySelectorAll(".motion-facts dd")].slice(0, 2).map(({textContent}) => textContent);
    const say = async (link) => {
      await it.hear("kr120", "view", standing({link}));
      it.tick();
      return facts();
    };
    assert.deepEqual(await say(view().link), [not, not]);
    assert.deepEqual(await say({...view().link, controller: {mode: "T1", program: "", override_percent: 0}}), ["T1", "0 %"]);
    assert.deepEqual(await say({...view().link, controller: {mode: "", program: "ACTIVE", override_percent: null}}), [not, not]);
    assert.deepEqual(await say(null), [unknown, unknown]);
  }
});

test("without a model the values are there, and why there are no limits", async () => {
  const it = panel(motion, {fetchText: async () => { throw new Error("robot.urdf: 404"); }});
  await it.hear("kr120", "view", standing());
  await settle();
  it.tick();
  assert.match(it.text(".motion-note"), /robot\.urdf: 404/);
  assert.equal(it.find(".motion-tool").hidden, true);
  assert.match(it.text(".motion-axes"), /-85\.94°/);
  assert.equal(it.parent.querySelectorAll(".motion-at:not([hidden])").length, 0);
});

test("waypoints are made when they are opened, of a plan that is what its hash says", async () => {
  const it = panel(waypoints);
  await it.hear("kr120", "view", view());
  await it.hear("kr120", "plan", plan(), true);
  assert.equal(it.find(".waypoints").hidden, false);
  assert.equal(it.parent.querySelectorAll("td").length, 0);
  it.find(".waypoints").setAttribute("open", "");
  it.find(".waypoints").dispatchEvent(new it.window.Event("toggle"));
  assert.deepEqual([...it.parent.querySelectorAll("tbody tr")].map((row) => [...row.children].map(({textContent}) => textContent)), [["0.00", "0.00"], ["1.00", "57.30"]]);
  await it.hear("kr120", "plan", plan({id: "p2", hash: "h2"}), true);
  assert.equal(it.find(".waypoints").hasAttribute("open"), false);
  assert.equal(it.parent.querySelectorAll("td").length, 0);
  await it.hear("kr120", "plan", null, true);
  assert.equal(it.find(".waypoints").hidden, true);
  const forged = panel(waypoints, {check: async (each) => ({...each, refused: "hash"})});
  await forged.hear("kr120", "plan", plan(), true);
  assert.equal(forged.find(".waypoints").hidden, true);
});

// -- the tool's goal as numbers

test("numbers are taken with a comma too, and anything else is not", () => {
  assert.deepEqual(["12,5", " −3 ", "+.5", "7."].map((text) => numberOf(text, 100)), [12.5, -3, 0.5, 7]);
  for (const text of ["", "x", "1e3", "1.2.3", "101", "NaN"]) assert.equal(numberOf(text, 100), null);
});

test("a pose that is typed goes out whole, and one with a mistake not at all", () => {
  const {parent, document, window, click} = fakePage();
  const poses = [];
  const fields = makeToolFields(parent, textsIn("en"), (kind, pose) => poses.push({kind, ...pose}));
  const pose = {position: [1.35, 0, 1.569], quaternion: fromAngles({a: 180, b: 0, c: 180})};
  fields.show(pose);
  const inputs = [...document.querySelectorAll("input")];
  assert.deepEqual(inputs.map(({value}) => value), textsOf(pose));
  assert.deepEqual(inputs.slice(0, 3).map(({value}) => value), ["1350.0", "0.0", "1569.0"]);
  inputs[2].value = "1400,5";
  fields.show(pose);
  assert.equal(inputs[2].value, "1400,5", "what is typed stays while the goal is the same");
  click(document.querySelector(".plan-tool-line"));
  assert.equal(poses[0].kind, "line");
  near(poses[0].position[2], 1.4005);
  near(Math.abs(poses[0].quaternion.reduce((sum, part, k) => sum + part * pose.quaternion[k], 0)), 1);
  inputs[0].value = "far";
  inputs[0].dispatchEvent(new window.Event("input"));
  click(document.querySelector(".plan-tool-pose"));
  assert.equal(poses.length, 1);
  assert.equal(inputs[0].getAttribute("aria-invalid"), "true");
  assert.match(document.querySelector(".plan-tool-note").textContent, /Write numbers/);
});
