import assert from "node:assert/strict";
import {test} from "node:test";
import {advanced, durationOf, rewound, sample, sought, toggled, wasPlayed} from "../src/motion.js";

const MOTION = {
  times: [0, 0.7, 2], positions: [[0, 1], [0.4, 0.5], [1, -1]], velocities: [[0, 0], [0.5, -0.6], [0, 0]],
  accelerations: [[0, 0], [0.1, 0.2], [0, 0]],
};

test("between waypoints the motion is the one that the executor plays", () => {
  // values of Trajectory.sample in robot/trajectory.py
  for (const [time, expected] of [
    [0, [0, 1]], [0.35, [0.14607812500000006, 0.81715625]], [0.7, [0.4, 0.5]], [1.1, [0.6343190095153962, 0.09205591271583344]],
    [1.999, [0.9999999984923946, -0.9999999945217858]], [2, [1, -1]],
  ]) {
    sample(MOTION, time).forEach((value, joint) => assert.ok(Math.abs(value - expected[joint]) < 1e-12, `${time}: ${value}`));
  }
  assert.deepEqual(sample(MOTION, -1), [0, 1]);
  assert.deepEqual(sample(MOTION, 9), [1, -1]);
  assert.deepEqual(sample(MOTION, NaN), [0, 1]);
  assert.equal(durationOf(MOTION), 2);
});

const play = (playback, seconds, each = 0.04) => {
  for (let k = 0; k < Math.round(seconds / each); k += 1) playback = advanced(playback, each);
  return playback;
};

test("a motion counts as played when nothing of it was left out", () => {
  const whole = play(toggled(rewound(2)), 2.1);
  assert.ok(wasPlayed(whole));
  assert.deepEqual([whole.time, whole.playing], [2, false]);
  assert.ok(!wasPlayed(play(toggled(rewound(2)), 1.9)));
});

test("a jump to the end is not a playback, and going back to what was left out makes it one", () => {
  let playback = play(toggled(rewound(2)), 0.5);
  playback = play(sought(playback, 1.5), 1);
  assert.equal(playback.time, 2);
  assert.ok(!wasPlayed(playback));
  playback = play(toggled(sought(playback, 0.3)), 2);
  assert.ok(wasPlayed(playback));
});

test("dragging the slider over the whole plan is not a playback", () => {
  let playback = rewound(2);
  for (let time = 0; time <= 2; time += 0.01) playback = sought(playback, time);
  assert.ok(!wasPlayed(sought(playback, 2)));
});

test("a page that stood still has not played meanwhile", () => {
  const playback = advanced(toggled(rewound(2)), 60);
  assert.equal(playback.time, 0.25);
});

test("play at the end begins anew; a pause stays where it is", () => {
  const end = play(toggled(rewound(1)), 1.2);
  assert.deepEqual([toggled(end).time, toggled(end).playing], [0, true]);
  const paused = toggled(play(toggled(rewound(2)), 0.4));
  assert.equal(advanced(paused, 0.04).time, paused.time);
});

test("what nobody could see goes on and does not count as seen", () => {
  let playback = toggled(rewound(1));
  playback = advanced(playback, 0.2);
  playback = advanced(playback, 0.2, false);
  assert.deepEqual([playback.time.toFixed(1), playback.seen.toFixed(1)], ["0.4", "0.2"]);
  // nor what comes behind the gap
  while (playback.playing) playback = advanced(playback, 0.2);
  assert.equal(wasPlayed(playback), false);
});
