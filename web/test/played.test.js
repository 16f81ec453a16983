/** The path of a plan that is played, split where the tool is, in lists and in the cell's picture. */
import assert from "node:assert/strict";
import {test} from "node:test";
import {playedOf, splitPath} from "../src/picture/played.js";
import {fakePage, view} from "./support/fake.js";

/** One second along x, one along y, half of the speed. */
const PATH = {plan_id: "p1", times: [0, 1, 2, 4], tool_path: [[0, 0, 1], [1, 0, 1], [1, 1, 1], [1, 2, 1]]};
const execution = (changes) => ({...view().execution, state: "PLAYING", plan_id: "p1", duration: 4, progress: 0.5, rate: 1, ...changes});
const robot = (changes) => ({path: PATH, view: view({execution: execution(changes)})});

test("a path is split where the tool is, by the time of the plan and not by its length", () => {
  assert.deepEqual(splitPath(PATH, 1.5), {travelled: [[0, 0, 1], [1, 0, 1], [1, 0.5, 1]], ahead: [[1, 0.5, 1], [1, 1, 1], [1, 2, 1]]});
  assert.deepEqual(splitPath(PATH, 3).ahead, [[1, 1.5, 1], [1, 2, 1]]);
});

test("at a waypoint it is split there, at its ends one part is empty, and no part has a piece without length", () => {
  assert.deepEqual(splitPath(PATH, 1), {travelled: [[0, 0, 1], [1, 0, 1]], ahead: [[1, 0, 1], [1, 1, 1], [1, 2, 1]]});
  for (const before of [-1, 0]) assert.deepEqual(splitPath(PATH, before), {travelled: [], ahead: PATH.tool_path});
  for (const after of [4, 9]) assert.deepEqual(splitPath(PATH, after), {travelled: PATH.tool_path, ahead: []});
});

test("the two parts together are the path, wherever they meet", () => {
  for (let seconds = 0; seconds <= 4; seconds += 0.05) {
    const {travelled, ahead} = splitPath(PATH, seconds);
    const length = (points) => points.slice(1).reduce((sum, point, k) => sum + Math.hypot(...point.map((value, axis) => value - points[k][axis])), 0);
    assert.ok(Math.abs(length(travelled) + length(ahead) - 3) < 1e-9, `${seconds}`);
    if (travelled.length && ahead.length) assert.deepEqual(travelled.at(-1), ahead[0]);
  }
});

test("two points at one time, times out of order and a single point break nothing", () => {
  const at = (times, points, seconds) => splitPath({times, tool_path: points}, seconds);
  assert.deepEqual(at([0, 1, 1, 2], PATH.tool_path, 1), {travelled: PATH.tool_path.slice(0, 3), ahead: PATH.tool_path.slice(2)});
  assert.ok(at([0, 3, 2, 4], PATH.tool_path, 2.5).ahead.flat().every(Number.isFinite));
  assert.deepEqual(at([0], [[1, 1, 1]], 0), {travelled: [], ahead: []});
});

test("it is shown while its own plan is under way, moving or at rest, and no longer", () => {
  for (const state of ["PLAYING", "STOPPING", "PAUSING", "PAUSED", "HELD", "AT_BOUNDARY"]) assert.equal(playedOf(robot({state})).travelled.length, 3, state);
  assert.deepEqual(playedOf(robot({})).end, [1, 2, 1]);
  assert.deepEqual([playedOf(robot({})).remaining, playedOf(robot({speed_limit: 0.5})).remaining, playedOf(robot({state: "PAUSED"})).remaining], [2, 4, null]);
  for (const none of [robot({state: "IDLE"}), robot({plan_id: "p2"}), {...robot({}), path: null}, {path: PATH, view: null}, null]) assert.equal(playedOf(none), null);
});

test("a path counts when the broker had stored it, and one whose points have no time or no place is refused", async () => {
  const page = fakePage();
  await page.hear("kr120", "path", PATH, true);
  assert.equal(page.store.robot("kr120").path.plan_id, "p1");
  for (const odd of [{...PATH, times: [0]}, {...PATH, tool_path: [[0, 0], ...PATH.tool_path.slice(1)]}, {...PATH, plan_id: ""}]) await page.hear("kr120", "path", odd);
  assert.equal(page.store.refused, 3);
  assert.equal(page.store.robot("kr120").path.times.length, 4);
  await page.hear("kr120", "path", null, true);
  assert.equal(page.store.robot("kr120").path, null);
  await page.hear("kr120", "path", PATH, true);
  page.connection.change("lost", "closed");
  assert.equal(page.store.robot("kr120").path, null);
});
