import assert from "node:assert/strict";
import {test} from "node:test";
import {ANSWER_WITHIN, begin, blocked, HELD_FOR, step, TABLE} from "../src/verdict_state.js";

const PLAN = {id: "p1", hash: "h1", refused: ""};
const ME = {account: "ada", reviewer: "ada"};

/** Run events through a machine; each is a type or an object. Time goes on by what `wait` says. */
function run(events, machine = begin(), from = 0) {
  let at = from;
  const published = [];
  for (const each of events) {
    const event = typeof each === "string" ? {type: each} : each;
    at += event.wait ?? 0;
    const {machine: next, publish} = step(machine, {...ME, ...event, at});
    if (publish !== null) published.push(publish);
    machine = next;
  }
  return {machine, published, at};
}

const plan = (changes = {}) => ({type: "plan", plan: {...PLAN, ...changes}});
const gone = {type: "plan", plan: null};
const view = (id = "p1") => ({type: "view", plan: id});
const shown = (ms, hash = "h1") => Array.from({length: ms / 200 + 1}, (_, k) => ({type: "looked", what: "shown", hash, wait: k ? 200 : 0}));
const checks = {type: "looked", what: "checks", hash: "h1"};
const played = {type: "looked", what: "played", hash: "h1"};
const hold = (ms) => Array.from({length: ms / 50}, () => ({type: "tick", wait: 50}));
const READY = ["connected", plan(), view(), ...shown(1000), checks];
const SENT = [...READY, "press", ...hold(HELD_FOR)];
const ack = (changes = {}) => ({type: "ack", ack: {account: "ada", reviewer: "ada", plan_id: "p1", plan_hash: "h1", verdict: "approved", ok: true,
  reason: "moves", ...changes}});

test("an approval goes out once the button was held for a second, with the hash of what was shown", () => {
  const {machine, published} = run(SENT);
  assert.deepEqual(published, [{plan_id: "p1", plan_hash: "h1", verdict: "approved", reviewer: "ada", reason: ""}]);
  assert.equal(machine.state, "sending");
  assert.equal(run([...SENT, ...hold(1000)]).published.length, 1);
});

for (const [what, events, why] of [
  ["nothing was looked at", ["connected", plan(), view(), ...shown(1000)], "look"],
  ["it was shown for less than a second", ["connected", plan(), view(), ...shown(800), checks], "shown"],
  ["another plan was shown", ["connected", plan(), view(), ...shown(1000, "h2"), checks], "shown"],
  ["the checks of another plan were opened", ["connected", plan(), view(), ...shown(1000), {...checks, hash: "h2"}], "look"],
  ["the page stood still meanwhile", ["connected", plan(), view(), ...shown(0), {...shown(0)[0], wait: 5000}, checks], "shown"],
  ["it is not what its hash says", ["connected", plan({refused: "trajectory"}), view(), ...shown(1000), checks], "unfit"],
  ["no view was heard", ["connected", plan(), ...shown(1000), checks], "old"],
  ["the view is old", [...READY, "old"], "old"],
  ["the view names no plan", [...READY, view("")], "view"],
  ["the connection is lost", [...READY, "disconnected"], "offline"],
  ["it was taken away", [...READY, gone], "none"],
  ["another tablet has approved it", [...READY, ack({account: "grace"})], "decided"],
]) {
  test(`a plan cannot be approved when ${what}`, () => {
    const {machine, published} = run([...events, "press", ...hold(2000)]);
    assert.deepEqual(published, []);
    assert.equal(blocked(machine), why);
  });
}

test("nobody without a name presses: a browser may tell of a finger on a button that is switched off", () => {
  const {machine, published} = run([...READY, {type: "press", reviewer: ""}, ...hold(2000)]);
  assert.deepEqual(published, []);
  assert.equal(machine.state, "open");
});

test("what was played to its end counts as what was looked at", () => {
  assert.equal(blocked(run(["connected", plan(), view(), ...shown(1000), played]).machine), "");
});

for (const [what, events] of [
  ["a reconnect", ["disconnected", "connected", plan(), view()]],
  ["a new plan", [plan({id: "p2", hash: "h2"}), view("p2"), plan(), view()]],
  ["the same plan under another id", [plan({id: "p2"}), view("p2")]],
  ["a view without the plan", [view(""), view()]],
  ["a plan that was taken away", [gone, plan(), view()]],
]) {
  test(`${what} resets what was looked at`, () => {
    const {machine} = run([...READY, ...events]);
    assert.equal(blocked(machine), "look");
  });
}

test("the same plan heard again keeps what was looked at", () => {
  assert.equal(blocked(run([...READY, plan(), view()]).machine), "");
});

for (const [what, event, why] of [
  ["is released", "release", "early"],
  ["is released at the last moment", {type: "release", wait: 0}, "early"],
  ["meets a lost connection", "disconnected", "offline"],
  ["meets another plan", plan({id: "p2", hash: "h2"}), "plan"],
  ["meets a plan that is taken away", gone, "plan"],
  ["meets a view that names another plan", view("p2"), "view"],
  ["meets an old view", "old", "old"],
  ["meets a page that stood still", {type: "tick", wait: 3000}, "stood"],
]) {
  test(`a press that ${what} before its second is over sends nothing`, () => {
    const {machine, published} = run([...READY, "press", ...hold(950), event, ...hold(2000)]);
    assert.deepEqual(published, []);
    assert.deepEqual(machine.notice, {kind: "cancelled", why});
  });
}

test("a tick after a gap sends nothing: a release that waits behind it is heard first", () => {
  const late = [...READY, "press", ...hold(400), {type: "tick", wait: 1200}];
  assert.deepEqual(run(late).published, []);
  assert.deepEqual(run([...late, "release", ...hold(1000)]).published, []);
  assert.equal(run([...late, ...hold(50)]).published.length, 1);
});

test("a press that meets another tablet's approval sends nothing and names the other", () => {
  const {machine, published} = run([...READY, "press", ...hold(500), ack({account: "grace"}), ...hold(2000)]);
  assert.deepEqual(published, []);
  assert.deepEqual([machine.notice.kind, machine.notice.account], ["other", "grace"]);
});

test("a rejection needs a reason and a name, and no looking", () => {
  const reject = (reason, changes = {}) => run(["connected", plan(), {type: "reject", reason, ...changes}]).published;
  assert.deepEqual(reject("  "), []);
  assert.deepEqual(reject("no", {reviewer: ""}), []);
  assert.deepEqual(reject(" too close "), [{plan_id: "p1", plan_hash: "h1", verdict: "rejected", reviewer: "ada", reason: "too close"}]);
  assert.equal(run(["connected", plan({refused: "missing"}), {type: "reject", reason: "not shown"}]).published.length, 1);
  assert.deepEqual(run([{type: "reject", reason: "no"}, "connected", {type: "reject", reason: "no"}]).published, []);
});

test("the broker's refusal is shown, and the plan must be looked at again", () => {
  const {machine} = run([...SENT, {type: "failed", reason: "refused"}]);
  assert.deepEqual(machine.notice, {kind: "failed", reason: "refused", verdict: "approved"});
  assert.equal(blocked(machine), "look");
});

test("the executor's answer is shown", () => {
  assert.deepEqual(run([...SENT, "taken", ack()]).machine.notice, {kind: "accepted", verdict: "approved", reason: "moves", plan: "p1"});
  const {machine} = run([...SENT, "taken", ack({ok: false, reason: "stale hash"})]);
  assert.deepEqual(machine.notice, {kind: "refused", verdict: "approved", reason: "stale hash"});
  // what was looked at stays so: the plan is the same
  assert.equal(blocked(machine), "");
  assert.equal(blocked(run([...SENT, "taken", ack({ok: false, reason: "too old", expired: true})]).machine), "look");
});

test("that an approval was accepted is said until its plan has ended", () => {
  const accepted = [...SENT, "taken", ack(), gone];
  assert.equal(run([...accepted, view("")]).machine.notice.kind, "accepted");
  assert.equal(run([...accepted, {...view(""), ended: "p0"}]).machine.notice.kind, "accepted", "another plan");
  assert.equal(run([...accepted, {...view(""), ended: "p1"}]).machine.notice, null);
});

test("what the executor would refuse cannot be pressed, and an approval that is being held down ends", () => {
  const against = {...view(), obstacle: "not in sync"};
  const {machine} = run([...READY, against]);
  assert.equal(blocked(machine), "obstacle");
  assert.equal(machine.obstacle, "not in sync");
  assert.equal(run([...READY, against, "press", ...hold(HELD_FOR)]).published.length, 0);
  const pressed = run([...READY, "press", ...hold(HELD_FOR / 2), against]).machine;
  assert.deepEqual([pressed.state, pressed.notice], ["open", {kind: "cancelled", why: "obstacle"}]);
  assert.equal(blocked(run([...READY, against, view()]).machine), "");
  assert.equal(blocked(run([...READY, against, "disconnected", "connected", plan(), view(), ...shown(1000), checks]).machine), "");
});

test("the answer may come before the broker's", () => {
  const {machine} = run([...SENT, ack(), "taken"]);
  assert.equal(machine.state, "decided");
});

test("an answer to a message of ours that could not be read is a refusal", () => {
  const unread = ack({plan_id: "", plan_hash: "", verdict: "", ok: false, reason: "too long"});
  assert.deepEqual(run([...SENT, "taken", unread]).machine.notice, {kind: "refused", verdict: "approved", reason: "too long"});
  assert.equal(run([...SENT, "taken", ack({...unread.ack, account: "grace"})]).machine.state, "waiting");
});

test("an answer to another plan or another account's refusal is not ours", () => {
  for (const other of [ack({plan_hash: "h2"}), ack({plan_id: "p2"}), ack({account: "grace", ok: false})]) {
    assert.equal(run([...SENT, "taken", other]).machine.state, "waiting");
  }
});

test("two tablets approve at once: the loser is told who won, and why its own did not count", () => {
  const {machine} = run([...SENT, "taken", gone, ack({account: "grace"}), ack({ok: false, reason: "no plan is under review"})]);
  assert.equal(machine.state, "decided");
  assert.deepEqual(machine.notice, {kind: "other", verdict: "approved", account: "grace", reason: "no plan is under review"});
});

test("a plan that is gone before its refusal comes is not under review again", () => {
  assert.equal(run([...SENT, "taken", gone, ack({ok: false})]).machine.state, "none");
  assert.equal(run([...SENT, gone, "taken", ack()]).machine.state, "decided");
});

test("without accounts an answer belongs to the name that was given", () => {
  const nobody = {account: "", reviewer: "Ada"};
  const events = SENT.map((event) => (typeof event === "string" ? {type: event, ...nobody} : {...event, ...nobody}));
  const own = {...ack({account: "", reviewer: "Ada"}), ...nobody};
  assert.equal(run([...events, own]).machine.notice.kind, "accepted");
  const other = {...ack({account: "", reviewer: "Grace"}), ...nobody};
  assert.deepEqual(run([...events, other]).machine.notice, {kind: "other", verdict: "approved", account: "Grace", reason: ""});
});

test("no answer within some seconds is said to be unknown, never to be no", () => {
  const waiting = [...SENT, "taken"];
  assert.equal(run([...waiting, {type: "tick", wait: ANSWER_WITHIN - 1}]).machine.state, "waiting");
  const {machine} = run([...waiting, {type: "tick", wait: ANSWER_WITHIN}]);
  assert.equal(machine.notice.kind, "unanswered");
  assert.equal(blocked(machine), "look");
});

test("an answer that comes after it was given up is still told", () => {
  const late = [...SENT, "taken", {type: "tick", wait: ANSWER_WITHIN}];
  const old = run([...late, ack({ok: false, expired: true, reason: "too old"})]).machine;
  assert.deepEqual([old.state, old.notice], ["open", {kind: "expired", verdict: "approved", reason: "too old"}]);
  assert.equal(run([...late, ack({ok: false})]).machine.notice.kind, "refused");
  assert.equal(run([...late, ack()]).machine.state, "decided");
  assert.deepEqual(run([...late, gone, ack()]).machine.notice, {kind: "accepted", verdict: "approved", reason: "moves", plan: "p1"});
  // of another plan, or another's
  assert.equal(run([...late, ack({plan_id: "p2", ok: false})]).machine.notice.kind, "unanswered");
  assert.equal(run([...late, ack({account: "grace", ok: false})]).machine.notice.kind, "unanswered");
});

test("an approval that was too old is told apart, and whoever approves anew looks again first", () => {
  const {machine} = run([...SENT, "taken", ack({ok: false, expired: true, reason: "too old"})]);
  assert.deepEqual(machine.notice, {kind: "expired", verdict: "approved", reason: "too old"});
  assert.deepEqual([machine.state, blocked(machine)], ["open", "look"]);
});

test("a connection that breaks before the answer leaves it unknown, also after it is back", () => {
  const {machine} = run([...SENT, "disconnected", "connected", plan(), view()]);
  assert.deepEqual(machine.notice, {kind: "unknown", verdict: "approved"});
  assert.equal(blocked(machine), "look");
});

test("nothing is sent after a reconnect that was pressed before", () => {
  const {published} = run([...READY, "press", "disconnected", "connected", plan(), view(), ...hold(3000)]);
  assert.deepEqual(published, []);
});

test("from every state a lost connection leads to offline, with nothing that could still be sent", () => {
  for (const state of new Set(TABLE.flatMap(({states}) => states))) {
    const machine = {...run(SENT).machine, state, pressedAt: 0, tickedAt: 0};
    const {machine: after, publish} = step(machine, {...ME, type: "disconnected", at: 5000});
    assert.equal(publish, null);
    if (state !== "offline") assert.deepEqual([after.state, after.plan, after.sent], ["offline", null, null]);
  }
});

test("random events never send an approval of what was not looked at", () => {
  let seed = 17;
  const random = (count) => {
    seed = (seed * 1103515245 + 12345) % 2147483648;
    return Math.floor(seed / 65536) % count;
  };
  const events = ["connected", "disconnected", plan(), plan({id: "p2", hash: "h2"}), gone, view(), view("p2"), view(""), "old", checks, played,
    {...checks, hash: "h2"}, ...shown(0), ...shown(0, "h2"), "press", "press", "release", {type: "tick"}, {type: "tick"}, "taken", {type: "failed", reason: "refused"}, ack(),
    ack({account: "grace"}), ack({ok: false})];
  let machine = begin();
  let at = 0;
  let sent = 0;
  const seen = {};
  for (let k = 0; k < 20000; k += 1) {
    const pick = k % 29 === 0 ? events[random(events.length)] : ["connected", view(machine.plan?.id ?? ""), ...shown(0, machine.plan?.hash ?? "h1"), {type: "tick"}, "press"][random(5)];
    const event = typeof pick === "string" ? {type: pick} : pick;
    at += 50;
    const before = machine;
    const {machine: after, publish} = step(machine, {...ME, ...event, at});
    machine = after;
    seen[machine.state] = true;
    if (publish === null) continue;
    sent += 1;
    assert.equal(publish.plan_hash, before.plan.hash);
    assert.ok(before.shownFor >= 1000 && (before.played || before.checks) && before.live && at - before.pressedAt >= HELD_FOR);
  }
  assert.ok(sent > 1, `${sent} approvals`);
  assert.ok(Object.keys(seen).length >= 7, Object.keys(seen).join());
});
