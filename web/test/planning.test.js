import assert from "node:assert/strict";
import {readFileSync} from "node:fs";
import {test} from "node:test";
import {showAsking} from "../src/planning/asking.js";
import {Goal} from "../src/planning/goal.js";
import {IkFollower, LOST_S, PERIOD_S} from "../src/planning/ik_follower.js";
import {ends, fromShown, shown, typed} from "../src/planning/joints.js";
import {modelOf} from "../src/planning/model.js";
import {MOST, Poses, read} from "../src/planning/poses.js";
import {answered, heardBroker, pressed, waited} from "../src/requests.js";
import {fakePage} from "./support/fake.js";
import {textsIn} from "./support/sentences.js";

const file = (name) => readFileSync(new URL(`support/${name}`, import.meta.url), "utf8");
const NAMES = ["track", "joint_a1", "joint_a2", "joint_a3", "joint_a4", "joint_a5", "joint_a6"];
const JOINTS = [
  {name: "a", type: "revolute", lower: -1, upper: 2},
  {name: "b", type: "prismatic", lower: 0, upper: 3},
];
const pose = (x) => ({position: [x, 0, 0], orientation: [0, 0, 0, 1]});

function storage(entries = {}) {
  const map = new Map(Object.entries(entries));
  return {getItem: (key) => map.get(key) ?? null, setItem: (key, value) => void map.set(key, value)};
}

// -- the tool's place

test("the tool is where the library's own kinematics has it", () => {
  const {base, tip, pose: tool} = modelOf(file("track.urdf"), NAMES);
  assert.deepEqual([base, tip], ["track_base", "tool0"]);
  for (const {joints, position, quaternion} of JSON.parse(file("track_poses.json"))) {
    const found = tool(joints);
    found.position.forEach((value, axis) => assert.ok(Math.abs(value - position[axis]) < 1e-8));
    // a quaternion and its negative are the same turn
    const same = quaternion.reduce((sum, value, part) => sum + value * found.quaternion[part], 0);
    assert.ok(Math.abs(Math.abs(same) - 1) < 1e-8);
  }
});

test("the tool may have a prefix; without one the end of the chain is the tool", () => {
  const tip = (name) => modelOf(file("track.urdf").replaceAll('"tool0"', `"${name}"`), NAMES).tip;
  assert.deepEqual(["left_tool0", "hand"].map(tip), ["left_tool0", "hand"]);
  assert.throws(() => modelOf("<html/>", NAMES), /no URDF/);
});

// -- joints

test("the limits are those of the model, in the order of the view", () => {
  const {joints: found} = modelOf(file("track.urdf"), NAMES);
  assert.deepEqual(found.map((joint) => joint.name), NAMES);
  assert.deepEqual(found.map((joint) => joint.type), ["prismatic", ...Array(6).fill("revolute")]);
  assert.ok(Math.abs(shown(found[1], found[1].upper) - 185) < 1e-9);
});

test("a joint that the model does not have, or has no limits, is named", () => {
  assert.throws(() => modelOf(file("track.urdf"), ["joint_b1"]), /joint_b1/);
  const open = '<robot name="r"><link name="x"/><link name="y"/><joint name="j" type="revolute"><parent link="x"/><child link="y"/></joint></robot>';
  assert.throws(() => modelOf(open, ["j"]), /joint j .*no limits/);
  assert.equal(modelOf(open.replace("revolute", "continuous"), ["j"]).joints[0].upper, Math.PI);
});

test("a slider ends inside the limits, never beyond", () => {
  for (const joint of [...modelOf(file("track.urdf"), NAMES).joints, ...JOINTS]) {
    const {min, max} = ends(joint);
    assert.ok(fromShown(joint, min) >= joint.lower - 1e-9 && fromShown(joint, max) <= joint.upper + 1e-9, joint.name);
    assert.ok(shown(joint, joint.upper) - max < 1.01);
  }
});

test("a typed number counts inside the limits only, with point or comma", () => {
  const [a, b] = JOINTS;
  assert.ok(Math.abs(typed(a, " 90,5 ") - 90.5 * (Math.PI / 180)) < 1e-12);
  assert.equal(typed(b, "1500"), 1.5);
  assert.equal(typed(a, "−10"), typed(a, "-10"));
  for (const text of ["", "180", "1e1", "0x10", "ten", "1.2.3", "Infinity", "."]) assert.equal(typed(a, text), null, text);
});

// -- the goal

test("a goal takes complete values inside the limits and nothing else", () => {
  const goal = new Goal(JOINTS);
  assert.equal(goal.isAskable, false);
  for (const wrong of [{a: 0}, {a: 3, b: 0}, {a: NaN, b: 0}, {a: "0", b: 0}]) assert.equal(goal.setJoints(wrong), false);
  assert.equal(goal.values, null);
  assert.equal(goal.setJoints({a: 0, b: 1, more: 5}), true);
  assert.deepEqual(goal.values, {a: 0, b: 1});
  assert.equal(goal.isAskable, true);
  assert.equal(goal.setJoints({a: 9, b: 1}), false);
  assert.deepEqual(goal.values, {a: 0, b: 1});
});

test("where the arm does not get nothing can be asked for, and the last joint values stay to be seen", () => {
  const goal = new Goal(JOINTS);
  goal.setJoints({a: 0, b: 1});
  goal.setAnswer(pose(1), {reach: "free", joints: {a: 0.5, b: 2}, sentence: ""});
  assert.deepEqual(goal.values, {a: 0.5, b: 2});
  assert.equal(goal.isAskable, true);
  goal.setAnswer(pose(9), {reach: "out", joints: null, sentence: "out of reach by 3 m"});
  assert.deepEqual([goal.values, goal.reach, goal.isAskable], [{a: 0.5, b: 2}, "out", false]);
  // an answer that contradicts itself, or is of another robot
  goal.setAnswer(pose(1), {reach: "free", joints: {a: 7, b: 2}, sentence: ""});
  assert.deepEqual([goal.reach, goal.isAskable], ["unknown", false]);
  // words that this page does not know, also such as every object has
  for (const reach of ["near_singular", "constructor", 3, undefined]) {
    goal.setAnswer(pose(1), {reach, joints: {a: 0.5, b: 2}, sentence: {}});
    assert.deepEqual([goal.reach, goal.sentence, goal.isAskable], ["unknown", "", false]);
  }
  goal.setJoints({a: 0.1, b: 2});
  assert.deepEqual([goal.pose, goal.isAskable], [null, true]);
});

// -- dragging

test("of many moves the newest is asked for, at most 15 in a second", () => {
  const follower = new IkFollower("run");
  const asked = [];
  for (let at = 0; at < 10; at += 0.005) {
    follower.drag(pose(at));
    const question = follower.take(at, null);
    if (question === null) continue;
    asked.push([at, question.position[0]]);
    follower.answer({id: question.id, reach: "free", joints: {}});
  }
  assert.ok(asked.length <= 150 && asked.length > 110, `${asked.length}`);
  for (const [at, x] of asked) assert.equal(x, at);
  for (let number = 15; number < asked.length; number += 1) assert.ok(asked[number][0] - asked[number - 15][0] > 1);
});

test("the last move is asked for once it may be", () => {
  const follower = new IkFollower("run");
  follower.drag(pose(1));
  const first = follower.take(0, {a: 1});
  assert.deepEqual(first, {id: "run-1", ...pose(1), seed: {a: 1}});
  follower.drag(pose(2));
  assert.equal(follower.take(0.01, null), null);
  const wait = follower.wait(0.01);
  assert.ok(wait > 0 && wait < PERIOD_S);
  assert.equal(follower.take(0.01 + wait, null).position[0], 2);
  assert.equal(follower.wait(1), null);
});

test("a planner that does not answer is asked no more than twice, until a question counts as lost", () => {
  const follower = new IkFollower("run");
  let asked = 0;
  for (let at = 0; at < LOST_S; at += 0.02) {
    follower.drag(pose(at));
    if (follower.take(at, null) !== null) asked += 1;
  }
  assert.equal(asked, 2);
  assert.notEqual(follower.take(LOST_S + 0.01, null), null);
});

test("answers count by their id: none of another's, none that is older than the last", () => {
  const follower = new IkFollower("run");
  follower.drag(pose(1));
  follower.take(0, null);
  follower.drag(pose(2));
  follower.take(1, null);
  for (const id of ["other-1", "run-3", "run-", "run-1.0", "run-0", "run-1e0", 1, undefined, "run-x-1"]) {
    assert.equal(follower.answer({id}), null, String(id));
  }
  assert.equal(follower.settled, false);
  assert.notEqual(follower.answer({id: "run-2"}), null);
  assert.equal(follower.answer({id: "run-1"}), null);
  assert.equal(follower.answer({id: "run-2"}), null);
  assert.equal(follower.settled, true);
});

test("after the drag was dropped, what was asked before counts no more", () => {
  const follower = new IkFollower("run");
  follower.drag(pose(1));
  follower.take(0, null);
  follower.drop();
  assert.equal(follower.settled, true);
  assert.equal(follower.answer({id: "run-1"}), null);
  assert.equal(follower.isLost(99), false);
  follower.drag(pose(2));
  assert.equal(follower.take(1, null).id, "run-2");
  assert.equal(follower.isLost(1.5), false);
  assert.equal(follower.isLost(1 + LOST_S), true);
  assert.notEqual(follower.answer({id: "run-2"}), null);
  assert.equal(follower.isLost(9), false);
});

// -- saved poses

test("a saved pose is there again, for its robot only", () => {
  const kept = storage();
  const poses = new Poses(kept, "left", JOINTS);
  assert.equal(poses.save(" home ", {a: 0, b: 1, more: 2}), "");
  assert.equal(poses.save("above", {a: 1, b: 1}), "");
  assert.equal(poses.save("home", {a: 0.5, b: 1}), "");
  const again = new Poses(kept, "left", JOINTS);
  assert.deepEqual(again.list, [{name: "above", joints: {a: 1, b: 1}}, {name: "home", joints: {a: 0.5, b: 1}}]);
  assert.equal(new Poses(kept, "right", JOINTS).list.length, 0);
  assert.equal(again.remove("above"), "");
  assert.equal(new Poses(kept, "left", JOINTS).find("above"), null);
});

test("what does not fit is left out and counted", () => {
  const good = {name: "p", joints: {a: 0, b: 1}};
  const wrong = [
    null, 3, "p", [], {}, {name: "q"}, {name: "", joints: good.joints}, {name: "x".repeat(41), joints: good.joints},
    {name: "a\u0000", joints: good.joints},
    {name: "q", joints: {a: 0}}, {name: "q", joints: {a: 0, b: 1, c: 2}},
    {name: "q", joints: {a: 9, b: 1}}, {name: "q", joints: {a: "0", b: 1}},
    {name: "q", joints: {a: null, b: 1}}, good,
  ];
  assert.deepEqual(read(JSON.stringify([good, ...wrong]), JOINTS), {poses: [good], dropped: wrong.length});
  for (const text of ["", "{", "{}", "3", '"x"']) assert.deepEqual(read(text, JOINTS), {poses: [], dropped: 1}, text);
  assert.deepEqual(read(null, JOINTS), {poses: [], dropped: 0});
  const own = read('[{"name": "p", "joints": {"a": 0, "b": 1, "__proto__": {"c": 1}}}]', JOINTS);
  assert.equal(own.poses.length, 0);
});

test("a pose that cannot be kept is told, and the list stays", () => {
  const forbidden = {
    getItem() {
      throw new Error("forbidden");
    },
    setItem() {
      throw new Error("forbidden");
    },
  };
  const poses = new Poses(forbidden, "r", JOINTS);
  assert.deepEqual([poses.save("p", {a: 0, b: 0}), poses.list.length], ["storage", 0]);
  const full = new Poses(storage(), "r", JOINTS);
  for (let number = 0; number < MOST; number += 1) assert.equal(full.save(`p${number}`, {a: 0, b: 0}), "");
  assert.equal(full.save("one more", {a: 0, b: 0}), "full");
  assert.equal(full.save("p3", {a: 1, b: 0}), "");
  assert.equal(full.save("   ", {a: 0, b: 0}), "name");
});

// -- asking

test("that there is a plan is said while it is under review; else what became of the request", () => {
  const {parent} = fakePage();
  const sent = heardBroker(pressed("plan_request", "1", 0), "1", "taken");
  const told = (record, reviewed = "") => {
    showAsking(parent, record, reviewed, "ada", textsIn("en"));
    return parent.textContent;
  };
  const found = answered(sent, {id: "1", account: "ada", ok: true, reason: "", plan_id: "p7", duration: 2}, "ada");
  assert.match(told(found, "p7"), /There is a plan \(2\.0 s\)/);
  assert.deepEqual([told(found, "p8"), told(found)], ["", ""]);
  assert.match(told(answered(sent, {id: "1", account: "ada", reason: "out of reach"}, "ada")), /^No plan: out of reach/);
  assert.match(told(waited(sent, 59_999)), /planner is looking/);
  for (const lost of [waited(sent, 60_000), heardBroker(sent, "1", "unanswered")]) assert.match(told(lost), /may have arrived/);
  assert.match(told(heardBroker(sent, "1", "nobody")), /Nobody takes requests/);
  assert.match(told(heardBroker(sent, "1", "refused")), /account ada/);
});
