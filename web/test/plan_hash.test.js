import assert from "node:assert/strict";
import {createHash} from "node:crypto";
import {test} from "node:test";
import {checkPlan, trajectoryHash} from "../src/plan_hash.js";

const joints = ["joint_a1", "joint_a2"];
const trajectory = {
  times: [0, 0.004, 1.25], positions: [[0.1, -1.5], [0.1 + 1 / 3, -1.25], [0.7, -0]], velocities: [[0, 0], [1e-9, -3], [0, 0]],
  accelerations: [[0, 0], [2, 2], [0, 0]],
};
/** Computed by construction_twin.robot.trajectory.Trajectory(...).content_hash() for the numbers above. */
const HASH = "85bd20b511e57e1c817515bf6e7762d9244ad939c635e1327f8408fa00401caa";
const plain = {id: "p", hash: HASH, joints, trajectory};
const sha = (text) => createHash("sha256").update(text).digest("hex");

function work(change = {}) {
  const segment = {name: "go", end: 1.25, engaged: false, requires: [], switches: [], scene: "s", scene_after: "s"};
  const content = JSON.stringify({trajectory: HASH, task: "t", segments: [{...segment, ...change.covered}]});
  return {id: "p", hash: sha(content), joints, trajectory, content, segments: [{...segment, requires: {}, put: [], remove: []}], ...change.plan};
}

test("the hash is the one that the robot's side computes, through JSON", async () => {
  assert.equal(await trajectoryHash(joints, trajectory), HASH);
  const sent = JSON.parse('{"times": [0.0, 0.004, 1.25], "positions": [[0.1, -1.5], [0.43333333333333335, -1.25], [0.7, -0.0]], '
    + '"velocities": [[0.0, 0.0], [1e-09, -3.0], [0.0, 0.0]], "accelerations": [[0.0, 0.0], [2.0, 2.0], [0.0, 0.0]]}');
  assert.equal(await trajectoryHash(joints, sent), HASH);
});

test("a plan whose motion is what its hash says may be shown", async () => {
  assert.equal((await checkPlan(plain)).refused, "");
  const checked = await checkPlan(work());
  assert.equal(checked.refused, "");
  assert.equal(checked.covered.task, "t");
});

test("any other motion, name or order of joints is refused", async () => {
  const other = structuredClone(trajectory);
  other.positions[1][0] += 1e-12;
  assert.equal((await checkPlan({...plain, trajectory: other})).refused, "trajectory");
  assert.equal((await checkPlan({...plain, joints: [...joints].reverse()})).refused, "trajectory");
  assert.equal((await checkPlan({...plain, trajectory: {...trajectory, times: [0, 1, 2]}})).refused, "trajectory");
  assert.equal((await checkPlan({...plain, trajectory: {...trajectory, velocities: [[0, 0]]}})).refused, "trajectory");
  assert.equal((await checkPlan({...plain, trajectory: {...trajectory, times: [0, "1", 2]}})).refused, "trajectory");
  assert.equal((await checkPlan({...plain, trajectory: 7})).refused, "trajectory");
});

test("a plan without its motion cannot be shown as what is approved", async () => {
  assert.equal((await checkPlan({...plain, trajectory: null})).refused, "missing");
  assert.equal((await checkPlan({...plain, trajectory: undefined})).refused, "missing");
});

test("a work plan's text must be what its hash says, and name the motion and the segments that are shown", async () => {
  assert.equal((await checkPlan({...work(), content: `${work().content} `})).refused, "content");
  assert.equal((await checkPlan({...work(), segments: []})).refused, "content");
  const shown = work();
  shown.segments[0].scene_after = "another";
  assert.equal((await checkPlan(shown)).refused, "content");
  const other = structuredClone(trajectory);
  other.times[2] = 1.5;
  assert.equal((await checkPlan({...work(), trajectory: other})).refused, "trajectory");
  // segments beside the hash of a plain motion are covered by nothing
  assert.equal((await checkPlan({...plain, segments: work().segments})).refused, "content");
});

test("what is shown of a plan is what its hash covers, whatever the message says beside it", async () => {
  const plain_ = await checkPlan({...plain, duration: 99, goal: [3, 3]});
  assert.deepEqual([plain_.refused, plain_.duration, plain_.goal], ["", 1.25, [0.7, -0]]);
  const work_ = await checkPlan(work({plan: {task: "another", duration: 99, goal: [3, 3]}}));
  assert.deepEqual([work_.refused, work_.task, work_.duration, work_.goal], ["", "t", 1.25, [0.7, -0]]);
});
