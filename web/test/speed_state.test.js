import assert from "node:assert/strict";
import {test} from "node:test";
import * as speed from "../src/speed_state.js";

const {idle, moved, due, lowered, passed, raise, handle, known} = speed;

test("the steps are of 5 %, from 5 to 100", () => {
  assert.deepEqual([100, 97.5, 33.3, 10, 5].map(speed.below), [95, 95, 30, 5, 5]);
  assert.deepEqual([100, 97.5, 33.3, 5].map(speed.above), [100, 100, 35, 10]);
  assert.equal(speed.percentOf(0.29), 29);
  assert.equal(speed.percentOf(1 / 3), 33.3);
});

test("lowering goes out at once, then at a pace, and the last of it always", () => {
  let record = moved(idle(), 90, 100, 0);
  assert.equal(due(record, 100, 0), 90);
  record = lowered(record, 90, 0);
  assert.equal(due(record, 100, 0), null);
  record = moved(record, 60, 100, 50);
  record = moved(record, 40, 100, 100);
  assert.equal(due(record, 100, 100), null);
  assert.equal(due(record, 100, speed.PACE), 40);
});

test("back up while a lower one is on its way is a raise, and goes nowhere by itself", () => {
  let record = lowered(moved(idle(), 40, 100, 0), 40, 0);
  assert.equal(known(record, 100), 40);
  record = moved(record, 60, 100, 50);
  assert.equal(due(record, 100, 500), null);
  assert.equal(raise(record, 100), 60);
  assert.equal(handle(record, 100), 60);
});

test("what somebody else sets sends nothing", () => {
  let record = moved(idle(), 80, 50, 0);
  assert.equal(raise(record, 50), 80);
  record = passed(record, 90, 100);
  assert.equal(due(record, 90, 100), null);
  assert.equal(raise(record, 90), null);
  assert.equal(handle(record, 90), 90);
});

test("a limit that nobody confirms is forgotten", () => {
  const asked = moved(idle(), 80, 50, 0);
  assert.equal(due(asked, 50, 5000), null);
  assert.equal(handle(passed(asked, 50, 9999), 50), 80);
  assert.equal(handle(passed(asked, 50, speed.FORGOTTEN_AFTER), 50), 50);
});

test("what was lowered counts until the robot shows it, or until it has failed", () => {
  const on = lowered(moved(idle(), 40, 100, 0), 40, 0);
  for (const word of ["sending", "waiting", "done"]) assert.equal(known(passed(on, 100, 500, word), 100), 40);
  assert.equal(passed(on, 40, 100, "done").lowered, null);
  for (const word of ["refused", "not_sent", "no_right", "silent", "unknown"]) assert.equal(known(passed(on, 100, 100, word), 100), 100);
  assert.equal(known(passed(on, 100, 1000, "done"), 100), 100);
});

test("nothing may be set without a connection, without a view", () => {
  const view = {online: true, speed: null};
  const shown = {connected: true, view, old: false};
  assert.equal(speed.blocked(shown), "");
  assert.equal(speed.blocked({...shown, connected: false}), "offline");
  assert.equal(speed.blocked({...shown, view: null}), "old");
  assert.equal(speed.blocked({...shown, old: true}), "old");
  assert.equal(speed.blocked({...shown, view: {online: false, speed: null}}), "old");
});

test("a lost connection ends what was begun", () => {
  assert.equal(handle(speed.connectionChanged(moved(idle(), 80, 50, 0)), 50), 50);
});

test("whatever a person and others do, nothing goes out by itself that is not lower than what is shown", () => {
  let seed = 7;
  const random = (most) => {
    seed = (seed * 1103515245 + 12345) % 2147483648;
    return Math.floor(seed / 65536) % most;
  };
  for (let run = 0; run < 300; run += 1) {
    let record = idle();
    let people = 100;
    for (let at = 0; at < 20000; at += 50) {
      const act = random(8);
      if (act < 4) record = moved(record, 5 + 5 * random(20), people, at);
      else if (act === 4) people = 5 + 5 * random(20);
      record = passed(record, people, at, ["sending", "done", "refused"][random(3)]);
      const lower = due(record, people, at);
      assert.ok(lower === null || lower < people && at - record.sentAt >= speed.PACE);
      assert.ok(raise(record, people) === null || raise(record, people) > known(record, people));
      if (lower !== null) record = lowered(record, lower, at);
    }
  }
});
