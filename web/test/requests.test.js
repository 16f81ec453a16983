import assert from "node:assert/strict";
import {test} from "node:test";
import {answered, heardBroker, idle, markLate, outcome, pressed} from "../src/requests.js";

const answer = (by, ok, changes = {}) => ({id: "1", account: "ada", ok, reason: by, by, ...changes});
const stop = () => heardBroker(pressed("stop", "1", 0), "1", "taken");

test("a press goes from sent to answered", () => {
  assert.equal(outcome(idle()), "none");
  assert.equal(outcome(pressed("stop", "1", 0)), "sending");
  assert.equal(outcome(stop()), "waiting");
  assert.equal(outcome(answered(stop(), answer("gateway", true), "ada")), "done");
});

test("a second without an answer is told, whatever the broker said", () => {
  assert.equal(outcome(markLate(stop(), 999)), "waiting");
  assert.equal(outcome(markLate(stop(), 1000)), "silent");
  assert.equal(outcome(markLate(pressed("stop", "1", 0), 1000)), "silent");
  assert.equal(outcome(answered(markLate(stop(), 1000), answer("gateway", true), "ada")), "done");
});

test("a stop that did not go out is never anything else", () => {
  for (const [word, told] of [["not_connected", "not_sent"], ["refused", "no_right"], ["unanswered", "unknown"], ["broker", "unknown"], ["format", "unknown"]]) {
    assert.equal(outcome(heardBroker(pressed("stop", "1", 0), "1", word)), told);
    assert.equal(outcome(markLate(heardBroker(pressed("stop", "1", 0), "1", word), 5000)), told);
  }
});

test("one who stops is enough; that one has nothing to stop does not hide that the other has not answered", () => {
  const none = answered(stop(), answer("executor", false), "ada");
  assert.equal(outcome(none), "waiting");
  assert.equal(outcome(markLate(none, 1000)), "refused");
  assert.equal(outcome(answered(none, answer("gateway", true), "ada")), "done");
  assert.equal(outcome(answered(none, answer("gateway", false), "ada")), "refused");
});

test("answers to another press or of another account are not ours", () => {
  assert.equal(outcome(answered(stop(), answer("gateway", true, {id: "2"}), "ada")), "waiting");
  assert.equal(outcome(answered(stop(), answer("gateway", true), "grace")), "waiting");
  assert.equal(outcome(heardBroker(stop(), "2", "refused")), "waiting");
  assert.equal(outcome(answered(idle(), answer("gateway", true, {id: ""}), "ada")), "none");
});

test("a resume that was too old is told apart, and so is one that was not sent because nothing is shown", () => {
  const sent = heardBroker(pressed("resume", "1", 0), "1", "taken");
  assert.equal(outcome(answered(sent, answer("executor", false, {expired: true}), "ada")), "expired");
  assert.equal(outcome(heardBroker(pressed("resume", "1", 0), "1", "not_shown")), "expired");
});

test("pause and resume are the executor's", () => {
  for (const verb of ["pause", "resume"]) {
    const sent = heardBroker(pressed(verb, "1", 0), "1", "taken");
    assert.equal(outcome(answered(sent, answer("executor", false), "ada")), "refused");
    assert.equal(outcome(answered(sent, answer("executor", true), "ada")), "done");
  }
});
