import assert from "node:assert/strict";
import {readFileSync} from "node:fs";
import {test} from "node:test";
import {showAsking} from "../src/planning/asking.js";
import {ends, fromShown, shown, typed} from "../src/planning/joints.js";
import {modelOf} from "../src/planning/model.js";
import {MOST, Poses, read} from "../src/planning/poses.js";
import {answered, heardBroker, markLate, pressed} from "../src/requests.js";
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
  assert.match(told(markLate(sent, 59_999)), /planner is looking/);
  for (const lost of [markLate(sent, 60_000), heardBroker(sent, "1", "unanswered")]) assert.match(told(lost), /may have arrived/);
  assert.match(told(heardBroker(sent, "1", "nobody")), /Nobody takes requests/);
  assert.match(told(heardBroker(sent, "1", "refused")), /account ada/);
});
