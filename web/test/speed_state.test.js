import assert from "node:assert/strict";
import {test} from "node:test";
import * as speed from "../src/speed_state.js";

const {idle, moved, due, sent, heardBroker, answered, passed, held, released, confirmed, raise, outcome, handle, known} = speed;
const answer = (id, changes = {}) => ({id, account: "dora", ok: true, reason: "so be it", expired: false, limit: 0.5, ...changes});

test("the steps are of 5 %, from 5 to 100", () => {
  assert.deepEqual([100, 97.5, 33.3, 10, 5].map(speed.below), [95, 95, 30, 5, 5]);
  assert.deepEqual([100, 97.5, 33.3, 5].map(speed.above), [100, 100, 35, 10]);
  assert.equal(speed.percentOf(0.29), 29);
  assert.equal(speed.percentOf(1 / 3), 33.3);
});

test("lowering goes out at once, then at a pace, and the last of it always", () => {
  let record = moved(idle(), 90, 100, 0);
  assert.equal(due(record, 100, 0), 90);
  record = sent(record, "lower", 90, "1", 0);
  assert.equal(due(record, 100, 0), null);
  record = moved(record, 60, 100, 50);
  record = moved(record, 40, 100, 100);
  assert.equal(due(record, 100, 100), null);
  assert.equal(due(record, 100, speed.PACE), 40);
});

test("back up while a lower one is on its way is a raise, and goes nowhere by itself", () => {
  let record = sent(moved(idle(), 40, 100, 0), "lower", 40, "1", 0);
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

test("raising is a hold of a second on the limit that is shown", () => {
  const asked = moved(idle(), 80, 50, 0);
  assert.equal(due(asked, 50, 5000), null);
  const record = held(asked, 50, 100);
  assert.equal(confirmed(record, 50, 1099), null);
  assert.equal(confirmed(record, 50, 1100), 80);
  assert.equal(confirmed(released(record), 50, 1100), null);
  assert.equal(confirmed(passed(record, 30, 500), 30, 1100), null);
  assert.equal(confirmed(record, 30, 1100), null);
  assert.equal(confirmed(moved(record, 90, 50, 600), 50, 1100), null);
  assert.equal(held(idle(), 50, 0).heldAt, null);
});

test("a limit that nobody confirms is forgotten, but not under the finger", () => {
  const asked = moved(idle(), 80, 50, 0);
  assert.equal(handle(passed(asked, 50, 9999), 50), 80);
  assert.equal(handle(passed(asked, 50, speed.FORGOTTEN_AFTER), 50), 50);
  assert.equal(handle(passed(held(asked, 50, 9900), 50, 10500), 50), 80);
});

test("what was lowered counts until the robot shows it, or until it has failed", () => {
  const on = sent(moved(idle(), 40, 100, 0), "lower", 40, "1", 0);
  assert.equal(known(answered(on, answer("1"), "dora"), 100), 40);
  assert.equal(passed(on, 40, 100).lowered, null);
  assert.equal(known(answered(on, answer("1", {ok: false}), "dora"), 100), 100);
  assert.equal(known(heardBroker(on, "1", "not_connected"), 100), 100);
  assert.equal(known(passed(on, 100, 1000), 100), 100);
});

test("what became of a message is one word", () => {
  const on = (kind = "lower") => sent(idle(), kind, 40, "1", 0);
  const taken = heardBroker(on(), "1", "taken");
  assert.equal(outcome(idle()), "none");
  assert.equal(outcome(on()), "sending");
  assert.equal(outcome(taken), "waiting");
  assert.equal(outcome(passed(taken, 100, 1000)), "silent");
  assert.equal(outcome(answered(passed(taken, 100, 1000), answer("1"), "dora")), "done");
  assert.equal(outcome(answered(taken, answer("1", {ok: false}), "dora")), "refused");
  assert.equal(outcome(answered(taken, answer("1", {ok: false, expired: true}), "dora")), "expired");
  assert.equal(outcome(heardBroker(on("raise"), "1", "not_shown")), "expired");
  assert.equal(outcome(answered(taken, answer("2"), "dora")), "waiting");
  assert.equal(outcome(answered(taken, answer("1"), "ada")), "waiting");
  for (const [word, told] of [["not_connected", "not_sent"], ["refused", "no_right"], ["unanswered", "unknown"], ["broker", "unknown"]]) {
    assert.equal(outcome(passed(heardBroker(on(), "1", word), 100, 5000)), told);
  }
});

test("nothing may be set without a connection, without a view, without the limit", () => {
  const view = {online: true, speed: null};
  const shown = {connected: true, view, old: false};
  assert.equal(speed.blocked(shown), "");
  assert.equal(speed.blocked({...shown, connected: false}), "offline");
  assert.equal(speed.blocked({...shown, view: null}), "old");
  assert.equal(speed.blocked({...shown, old: true}), "old");
  assert.equal(speed.blocked({...shown, view: {online: false, speed: null}}), "old");
  assert.equal(speed.blocked({...shown, view: {online: true}}), "none");
});

test("a lost connection ends what was begun", () => {
  const record = speed.connectionChanged(held(moved(idle(), 80, 50, 0), 50, 0));
  assert.equal(confirmed(record, 50, 2000), null);
  assert.equal(handle(record, 50), 50);
});

test("whatever a person and others do, nothing higher than what is shown goes out without a hold", () => {
  let seed = 7;
  const random = (most) => {
    seed = (seed * 1103515245 + 12345) % 2147483648;
    return Math.floor(seed / 65536) % most;
  };
  for (let run = 0; run < 300; run += 1) {
    let record = idle();
    let people = 100;
    let holding = 0;
    for (let at = 0, id = 0; at < 20000; at += 50) {
      const act = random(12);
      if (act < 4) record = moved(record, 5 + 5 * random(20), people, at);
      else if (act === 4) record = held(record, people, at);
      else if (act === 5) record = released(record);
      else if (act === 6) people = 5 + 5 * random(20);
      else if (act === 7 && record.message.id) record = answered(record, answer(record.message.id, {ok: random(2) === 0}), "dora");
      holding = record.heldAt === null ? 0 : at - record.heldAt;
      record = passed(record, people, at);
      const lower = due(record, people, at);
      const higher = confirmed(record, people, at);
      assert.ok(lower === null || lower < people && at - record.sentAt >= speed.PACE);
      assert.ok(higher === null || holding >= speed.HELD_FOR && record.of === people && higher > known(record, people));
      if (lower !== null) record = sent(record, "lower", lower, String(id += 1), at);
      else if (higher !== null) record = sent(record, "raise", higher, String(id += 1), at);
    }
  }
});
