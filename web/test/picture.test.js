import assert from "node:assert/strict";
import {test} from "node:test";
import {PerspectiveCamera, Vector3} from "three";
import {closestOf} from "../src/picture/closest.js";
import * as colours from "../src/picture/colours.js";
import {around, clipped, corners, fit} from "../src/picture/fit.js";
import {floorOf, makeFloor} from "../src/picture/floor.js";
import {placed, sizeOf} from "../src/picture/labels.js";
import {entriesOf} from "../src/picture/legend.js";
import {GERMAN} from "./support/sentences.js";

/** Numbers that look like chance, the same ones every time. */
function chance(seed) {
  let state = seed;
  return (low, high) => {
    state = (1103515245 * state + 12345) % 2147483648;
    return low + (high - low) * state / 2147483648;
  };
}
const near = (one, other, most = 1e-9) => assert.ok(Math.abs(one - other) <= most, `${one} is not ${other}`);

// -- camera

/** Where points are in the picture of a camera, as three's own projection has it: fractions from the upper left. */
function seen(points, {position, target}, fov, aspect) {
  const camera = new PerspectiveCamera(fov, aspect, 0.01, 1000);
  camera.up.set(0, 0, 1);
  camera.position.fromArray(position);
  camera.lookAt(new Vector3(...target));
  camera.updateMatrixWorld();
  return points.map((point) => new Vector3(...point).project(camera)).map(({x, y}) => [(x + 1) / 2, (1 - y) / 2]);
}

test("the camera sees all that it is fitted to, and is no farther away than that takes", () => {
  const next = chance(1);
  for (let k = 0; k < 200; k += 1) {
    const low = [next(-9, 0), next(-9, 0), next(-1, 0)];
    const points = corners(low, [next(0.1, 9), next(0.1, 9), next(0.1, 4)]);
    const aspect = next(0.4, 3);
    const inset = {left: next(0, 0.3), right: next(0, 0.2), top: next(0, 0.2), bottom: next(0, 0.2)};
    const direction = [next(-1, 1), next(-1, 1), next(0.05, 1)];
    const at = seen(points, fit(points, direction, 38, aspect, inset), 38, aspect);
    const [left, right] = [Math.min(...at.map(([x]) => x)), Math.max(...at.map(([x]) => x))];
    const [top, bottom] = [Math.min(...at.map(([, y]) => y)), Math.max(...at.map(([, y]) => y))];
    const slack = 1e-6;
    assert.ok(left >= inset.left - slack && right <= 1 - inset.right + slack && top >= inset.top - slack && bottom <= 1 - inset.bottom + slack);
    // it touches both edges of one of the two directions
    const wide = Math.abs(left - inset.left) + Math.abs(right - 1 + inset.right);
    const high = Math.abs(top - inset.top) + Math.abs(bottom - 1 + inset.bottom);
    assert.ok(Math.min(wide, high) < 1e-6, `${wide} ${high}`);
  }
});

test("an arm twice as large is seen from twice as far away, and what is far away moves the camera only so far", () => {
  const [small, large] = [1, 2].map((size) => fit(corners([-size, -size, 0], [size, size, 2 * size]), [1, -1, 0.5], 38, 1.5));
  small.position.forEach((value, k) => near(2 * value, large.position[k]));
  assert.deepEqual(clipped([[90, -1, -90]], 5), [[5, -1, -5]]);
  for (const [x, y, z] of around(2, 0.5)) near(Math.hypot(x, y, z), 1);
});

test("a single point is not looked at from within", () => {
  const {position, target} = fit([[1, 2, 3]], [1, 0, 0], 38, 1, undefined, 0.3);
  near(Math.hypot(...position.map((value, k) => value - target[k])), 0.3);
});

// -- floor

test("the floor is as large as what stands on it, in whole metres, and as high as the scene has it", () => {
  const floor = makeFloor();
  const half = (...points) => {
    floor.cover(points, -0.3);
    return floor.userData.half;
  };
  assert.deepEqual([half(), half([3.2, 0, 1], [-4.5, -2.5, 0]), half([1e6, 0, 0])], [3, 5, 30]);
  assert.equal(floor.position.z, -0.3);
});

const body = (name, changes) => ({
  name, shape: "box", size: [20, 20, 1], position: [0, 0, -0.5], orientation: [0, 0, 0, 1], link: "", mesh: "", padding: 0, touch: [], ...changes,
});

test("the floor is the scene's: a flat, wide box below the base", () => {
  assert.equal(floorOf([]), null);
  assert.deepEqual(floorOf([body("floor", {})]), {name: "floor", height: 0});
  assert.deepEqual(floorOf([body("pit", {position: [0, 0, -2]}), body("hall", {position: [0, 0, -1.1]})]), {name: "hall", height: -0.6000000000000001});
  for (const other of [{position: [0, 0, 0]}, {size: [1, 20, 1]}, {shape: "sphere", size: [3]}, {link: "tool0"}, {orientation: [0.1, 0, 0, 0.99]}]) {
    assert.equal(floorOf([body("x", other)]), null, JSON.stringify(other));
  }
});

// -- legend

const NOTHING_DRAWN = {
  both: null, twin: null, arm: null, plan: null, goal: null, path: null, engaged: null, ahead: null, travelled: null, closest: null, tool: null, carried: null, standing: null,
  elements: [],
};

test("the legend has what is drawn, in the colours that it is drawn in, and nothing else", () => {
  assert.deepEqual(entriesOf(NOTHING_DRAWN), []);
  const drawn = {
    ...NOTHING_DRAWN, twin: 0xff660d, arm: colours.BY_SYNC.HOLDING[0], goal: colours.GOAL,
    closest: {colour: colours.CLOSEST}, elements: [colours.BY_TASK.done[0], colours.BY_TASK.done[0], colours.BY_TASK.carried[0]],
  };
  assert.deepEqual(entriesOf(drawn).map(({words, colour}) => [words, colour]), [
    ["twin", 0xff660d], ["arm as measured", 0xffcc00], ["goal", colours.GOAL],
    ["closest point of the plan: {distance} mm after {time} s ({between})", colours.CLOSEST], ["done", colours.BY_TASK.done[0]], ["in work", colours.BY_TASK.carried[0]],
  ]);
});

test("every state of a task has an entry with words", () => {
  for (const colour of [...Object.values(colours.BY_TASK).map(([each]) => each), colours.NO_TASK[0], colours.PICKED[0]]) {
    const [{words}] = entriesOf({...NOTHING_DRAWN, elements: [colour]});
    assert.equal(typeof words, "string");
  }
});

// -- closest point

const clearance = {distance: 0.2, time: 1.5, between: ["link_4", "table"], point: [1, 0, 1]};

test("a plan under review has its closest point, and one that is not what its hash says has none", () => {
  assert.deepEqual(closestOf({plan: {refused: "", clearance}}), clearance);
  for (const plan of [null, {refused: "", clearance: null}, {refused: "trajectory", clearance}]) assert.equal(closestOf({plan}), null);
  assert.equal(closestOf({plan: {refused: "", clearance: {...clearance, distance: null, between: []}}}), null);
  assert.equal(closestOf(null), null);
});

// -- words

test("words have room or are not there: the more important first, none on another, on a button or outside", () => {
  const next = chance(7);
  const overlap = (a, b) => a.left < b.left + b.width && b.left < a.left + a.width && a.top < b.top + b.height && b.top < a.top + a.height;
  for (const [width, height] of [[300, 180], [848, 528]]) {
    const labels = Array.from({length: 60}, (_, k) => ({x: next(-50, width + 50), y: next(-50, height + 50), rank: k, ...sizeOf("213 mm")}));
    const taken = {x: width - 60, y: 0, width: 60, height};
    const shown = placed(labels, width, height, [taken]);
    assert.ok(shown.length > 3 && shown.length < 60);
    const rest = {left: taken.x, top: taken.y, width: taken.width, height: taken.height};
    shown.forEach((each, k) => {
      assert.ok(each.left >= 0 && each.top >= 0 && each.left + each.width <= width && each.top + each.height <= height);
      for (const other of [rest, ...shown.slice(k + 1)]) assert.ok(!overlap(each, other));
    });
  }
  const [first] = placed([1, 2].map((rank) => ({x: 150, y: 100, width: 290, height: 160, rank})), 300, 180);
  assert.equal(first, undefined);
  assert.deepEqual(placed([1, 2].map((rank) => ({x: 150, y: 100, width: 290, height: 60, rank})), 300, 180).map(({rank}) => rank), [2, 1]);
  assert.equal(placed([{x: NaN, y: 1, width: 1, height: 1, rank: 1}], 300, 180).length, 0);
});
