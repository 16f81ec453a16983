import assert from "node:assert/strict";
import {test} from "node:test";
import * as playback from "../src/panels/playback.js";
import * as status from "../src/panels/status.js";
import * as stop from "../src/panels/stop.js";
import * as verdict from "../src/panels/verdict.js";
import {textsIn} from "./support/sentences.js";
import {fakePage, plan, view, work} from "./support/fake.js";

const PLAN = plan({
  duration: 2, joints: ["joint_a1", "joint_a2"], start: [0, 0], goal: [1, 1],
  trajectory: {times: [0, 2], positions: [[0, 0], [1, 1]], velocities: [[0, 0], [0, 0]], accelerations: [[0, 0], [0, 0]]},
  clearance: {distance: 0.031, time: 0.5, between: ["link_3", "wall"], point: [1, 2, 3]},
  use: {velocity: [0.5, 0.4], acceleration: [0.9, 0.1], jerk: [0.2, 0.3]},
});
const LINE = {topic: "execution", state: "IDLE", level: 0, sentence: "The arm holds its pose.", waits_for: "", who: "", todo: "", page: "reference/states.md#execution"};

/** A page with one panel or several, and its clock: `pass(ms)` lets timers and pictures run every 50 ms. */
async function page(modules, options = {}) {
  const fake = fakePage({account: "ada", ...options});
  const timers = [];
  let frames = [];
  const clock = {
    now: () => fake.clock.now,
    every: (ms, call) => timers.push({ms, call, next: ms}),
    frame: (call) => frames.push(call),
    time: () => "14:05:12",
  };
  for (const module of modules) module.make(fake.parent, fake.store, fake.connection, fake.texts, clock);
  const settle = () => new Promise((resolve) => setImmediate(resolve));
  const pass = async (ms, each = 50, heard = true) => {
    for (let k = 0; k < ms / each; k += 1) {
      fake.later(each);
      if (heard && fake.connection.state === "connected") for (const name of fake.store.robots) await fake.hear(name, "view", view({plan: fake.store.robot(name).plan?.id ?? ""}));
      for (const timer of timers) {
        if (fake.clock.now < timer.next) continue;
        timer.next = fake.clock.now + timer.ms;
        timer.call();
      }
      const due = frames;
      frames = [];
      due.forEach((call) => call());
      await settle();
    }
  };
  const find = (selector) => fake.document.querySelector(selector);
  const fire = (element, type, values = {}) => {
    const event = new fake.window.Event(type, {bubbles: true, cancelable: true});
    Object.assign(event, values);
    element.dispatchEvent(event);
  };
  const choose = (select, value) => {
    [...select.options].find((option) => option.value === value).selected = true;
    fire(select, "change");
  };
  return {...fake, pass, choose, find, fire, settle, text: (selector) => find(selector).textContent};
}

async function planned(modules = [playback, verdict], options = {}) {
  const it = await page(modules, options);
  await it.hear("kr120", "view", view({plan: "p1"}));
  await it.hear("kr120", "plan", PLAN, true);
  return it;
}

async function ready() {
  const it = await planned();
  await it.pass(1400);
  openChecks(it);
  return it;
}

function openChecks({find, fire}) {
  find(".verdict-checks").setAttribute("open", "");
  fire(find(".verdict-checks"), "toggle");
}

// -- verdict

test("a plan can be approved after its checks were opened and a second, by a finger that stays", async () => {
  const it = await planned();
  const approve = it.find(".verdict-approve");
  assert.equal(approve.disabled, true);
  openChecks(it);
  assert.equal(approve.disabled, true);
  await it.pass(1400);
  assert.equal(approve.disabled, false);
  it.fire(approve, "pointerdown", {button: 0});
  await it.pass(900);
  assert.deepEqual(it.connection.sent, []);
  while (it.connection.sent.length === 0) await it.pass(50);
  assert.deepEqual(it.connection.sent, [{topic: "review/ada", robot: "kr120", qos: 1,
    payload: {plan_id: "p1", plan_hash: "h1", verdict: "approved", reviewer: "ada", reason: "", moment: it.store.moment("kr120")}}]);
  assert.match(it.store.moment("kr120"), /^c0ffee00-/);
  await it.pass(100);
  assert.match(it.text(".verdict-notice"), /executor has not answered/);
  await it.hear("kr120", "review/ack", {account: "ada", reviewer: "ada", plan_id: "p1", plan_hash: "h1", verdict: "approved", ok: true, reason: "it moves"});
  assert.match(it.text(".verdict-notice"), /accepted. it moves/);
  await it.hear("kr120", "plan", null);
  assert.match(it.text(".verdict-notice"), /accepted. it moves/);
});

test("an approval that was too late says so, and counts anew only for who has looked again", async () => {
  const it = await ready();
  it.fire(it.find(".verdict-approve"), "pointerdown", {button: 0});
  await it.pass(1100);
  it.fire(it.find(".verdict-approve"), "pointerup");
  await it.hear("kr120", "review/ack", {account: "ada", reviewer: "ada", plan_id: "p1", plan_hash: "h1", verdict: "approved", ok: false,
    expired: true, reason: "the approval is too old: it is of 6.0 s ago"});
  assert.match(it.text(".verdict-notice"), /^Approval does NOT count: .* Look again, then press anew\. the approval is too old/);
  assert.ok(it.find(".verdict-notice").classList.contains("is-bad"));
  assert.equal(it.find(".verdict-approve").disabled, true);
  assert.equal(it.find(".verdict-checks").hasAttribute("open"), false, "it has to be opened again");
  await it.pass(1400);
  assert.equal(it.find(".verdict-approve").disabled, true);
  openChecks(it);
  assert.equal(it.find(".verdict-approve").disabled, false);
});

test("a motion that no picture showed was not looked at", async () => {
  const it = await planned();
  it.click(it.find(".playback-play"));
  await it.pass(2300);
  assert.equal(it.find(".verdict-approve").disabled, true);
});

test("a plan can be approved after it was played to its end", async () => {
  const it = await planned();
  it.store.set("drawn", "kr120", "seen");
  it.click(it.find(".playback-play"));
  await it.pass(1500);
  assert.equal(it.find(".verdict-approve").disabled, true);
  await it.pass(800);
  assert.equal(it.find(".verdict-approve").disabled, false);
  assert.match(it.find(".verdict-steps").textContent, /done: played.*done: shown/s);
});

for (const word of ["away", "lost", "model"]) {
  test(`a plan that cannot be seen in the picture any more waits, and is played to its end once it can: ${word}`, async () => {
    const it = await planned();
    it.store.set("drawn", "kr120", "seen");
    it.click(it.find(".playback-play"));
    await it.pass(1000);
    assert.equal(it.find(".playback-waits").hidden, true);
    it.store.set("drawn", "kr120", word);
    const {time} = it.store.robot("kr120").playback;
    await it.pass(3000);
    assert.equal(it.store.robot("kr120").playback.time, time);
    assert.equal(it.find(".playback-waits").hidden, false);
    assert.equal(it.find(".verdict-approve").disabled, true);
    assert.equal(it.text(".verdict-hint"), it.texts(verdict.UNSEEN[word]));
    it.store.set("drawn", "kr120", "seen");
    assert.equal(it.text(".verdict-hint"), it.texts("Play the plan to its end, or open its checks, then it can be approved."));
    await it.pass(1300);
    assert.equal(it.find(".verdict-approve").disabled, false);
    // nobody approves what is not to be seen; what was reached stays
    it.store.set("drawn", "kr120", "away");
    assert.equal(it.find(".verdict-approve").disabled, true);
    assert.equal(it.text(".verdict-hint"), it.texts("The picture is not in view: come back to it, then the plan can be approved."));
    it.store.set("drawn", "kr120", "seen");
    assert.equal(it.find(".verdict-approve").disabled, false);
    it.store.set("said", "kr120", "cut");
    assert.equal(it.find(".verdict-approve").disabled, true);
    assert.equal(it.text(".verdict-hint"), it.texts("The sentence at the top is cut off or old: read it first."));
    it.store.set("said", "kr120", "whole");
    it.fire(it.find(".verdict-approve"), "pointerdown", {button: 0});
    await it.pass(1200);
    assert.equal(it.connection.sent.length, 1);
  });
}

test("why a playback does not count is said in both languages, and that there is no picture", async () => {
  for (const language of ["en", "de"]) {
    const it = await planned(undefined, {language});
    assert.equal(it.text(".verdict-hint"), textsIn(language)("There is no picture here, so a playback shows nothing: open the plan's checks, then it can be approved."));
    it.store.set("drawn", "kr120", "away");
    assert.equal(it.text(".verdict-hint"), textsIn(language)("The picture is not in view: come back to it, then the plan can be approved."));
    // the checks are another way to look, but not one to approve without the picture
    await it.pass(1400);
    openChecks(it);
    assert.equal(it.find(".verdict-approve").disabled, true);
    it.store.set("drawn", "kr120", "seen");
    assert.equal(it.find(".verdict-approve").disabled, false);
  }
});

for (const [way, down, up] of [
  ["pointer", ["pointerdown", {button: 0}], ["pointerup", {}]],
  ["pointer that slips off", ["pointerdown", {button: 0}], ["pointerleave", {}]],
  ["key", ["keydown", {key: " "}], ["keyup", {key: " "}]],
  ["key, and the focus goes", ["keydown", {key: "Enter"}], ["blur", {}]],
]) {
  test(`letting go early cancels: ${way}`, async () => {
    const it = await ready();
    const approve = it.find(".verdict-approve");
    it.fire(approve, ...down);
    await it.pass(900);
    it.fire(approve, ...up);
    await it.pass(2000);
    assert.deepEqual(it.connection.sent, []);
    assert.match(it.text(".verdict-notice"), /released/);
    it.fire(approve, ...down);
    await it.pass(1200);
    assert.equal(it.connection.sent.length, 1);
  });
}

test("a key that repeats is one press", async () => {
  const it = await ready();
  const approve = it.find(".verdict-approve");
  it.fire(approve, "keydown", {key: " "});
  for (let k = 0; k < 40; k += 1) {
    await it.pass(40);
    it.fire(approve, "keydown", {key: " ", repeat: true});
  }
  assert.equal(it.connection.sent.length, 1);
});

test("a right click does not press", async () => {
  const it = await ready();
  it.fire(it.find(".verdict-approve"), "pointerdown", {button: 2});
  await it.pass(1500);
  assert.deepEqual(it.connection.sent, []);
});

test("a lost connection takes the plan away, and nothing of a press goes out when it is back", async () => {
  const it = await ready();
  it.store.set("drawn", "kr120", "seen");
  it.fire(it.find(".verdict-approve"), "pointerdown", {button: 0});
  await it.pass(500);
  it.connection.change("lost", "closed");
  assert.equal(it.find(".verdict").hidden, true);
  assert.match(it.text(".verdict-none"), /Not connected/);
  await it.pass(1000);
  it.connection.change("connected");
  await it.hear("kr120", "view", view({plan: "p1"}));
  await it.hear("kr120", "plan", PLAN, true);
  await it.pass(3000);
  assert.deepEqual(it.connection.sent, []);
  assert.equal(it.find(".verdict-approve").disabled, true);
  assert.match(it.text(".verdict-hint"), /Play the plan/);
});

test("a view that stops takes the button away", async () => {
  const it = await ready();
  await it.pass(1200, 50, false);
  assert.equal(it.find(".verdict-approve").disabled, true);
  assert.match(it.text(".verdict-hint"), /present state is not known/);
});

test("the broker's refusal is told as a missing right", async () => {
  const it = await ready();
  it.connection.refuse("refused");
  it.fire(it.find(".verdict-approve"), "pointerdown", {button: 0});
  await it.pass(1200);
  assert.match(it.text(".verdict-notice"), /did NOT go out: this account does not have the right/);
});

test("a verdict that reached nobody is told at once not to count", async () => {
  const it = await ready();
  it.connection.answer(16);
  it.fire(it.find(".verdict-approve"), "pointerdown", {button: 0});
  await it.pass(1200);
  assert.match(it.text(".verdict-notice"), /Approval does NOT count: nobody takes verdicts/);
  assert.ok(it.find(".verdict-notice").classList.contains("is-bad"));
});

test("the tablet that was later is told who was first", async () => {
  const it = await ready();
  it.fire(it.find(".verdict-approve"), "pointerdown", {button: 0});
  await it.pass(1200);
  const ack = {reviewer: "x", plan_id: "p1", plan_hash: "h1", verdict: "approved"};
  await it.hear("kr120", "plan", null);
  await it.hear("kr120", "review/ack", {...ack, account: "grace", ok: true, reason: "it moves"});
  await it.hear("kr120", "review/ack", {...ack, account: "ada", ok: false, reason: "plan p1 is not under review"});
  assert.match(it.text(".verdict-notice"), /grace was first.*plan p1 is not under review/);
});

test("a plan that is not what its hash says is not shown, and can be rejected only", async () => {
  const it = await planned(undefined, {check: async (plan) => ({...plan, refused: "trajectory"})});
  await it.pass(2000);
  assert.match(it.text(".verdict-unfit"), /not the one that its hash names/);
  assert.equal(it.find(".verdict-act").hidden, true);
  assert.equal(it.find(".playback").hidden, true);
});

test("a rejection goes out with the reason that was picked and the person's words", async () => {
  const it = await planned();
  const reject = it.find(".verdict-reject");
  assert.equal(reject.disabled, true);
  const [words] = it.document.querySelectorAll(".verdict-rejection input");
  it.choose(it.find(".verdict-rejection select"), "the scene is not as shown");
  assert.equal(reject.disabled, false);
  it.enter(words, "the wall moved");
  it.click(reject);
  await it.settle();
  assert.deepEqual([it.connection.sent[0].payload.verdict, it.connection.sent[0].payload.reason], ["rejected", "the scene is not as shown: the wall moved"]);
});

test("without an account a name must be given, and goes to review", async () => {
  const it = await planned(undefined, {account: ""});
  await it.pass(1400);
  openChecks(it);
  assert.equal(it.find(".verdict-approve").disabled, true);
  assert.match(it.text(".verdict-hint"), /your name/);
  it.enter(it.find(".verdict-name input"), "Ada");
  it.fire(it.find(".verdict-approve"), "keydown", {key: "Enter"});
  await it.pass(1200);
  assert.deepEqual([it.connection.sent[0].topic, it.connection.sent[0].payload.reviewer], ["review", "Ada"]);
});

test("another robot's plan is told, and its verdict goes to that robot only", async () => {
  const it = await ready();
  await it.hear("kr6", "view", view({plan: "p9"}));
  await it.hear("kr6", "plan", {...PLAN, id: "p9", hash: "h9"}, true);
  assert.match(it.text(".verdict-other"), /kr6/);
  it.fire(it.find(".verdict-approve"), "pointerdown", {button: 0});
  await it.pass(500);
  it.store.select("kr6");
  await it.pass(1500);
  assert.deepEqual(it.connection.sent, []);
  assert.equal(it.find(".verdict-approve").disabled, true);
});

test("the checks say what the hash covers of a work plan, in words", async () => {
  const segments = [{name: "fetch", end: 1, engaged: true, requires: [{name: "held", value: false}], scene: "a", scene_after: "b",
    switches: [{output: "vacuum", value: true, confirm: [{name: "held", value: true}], timeout: 1}]},
  {name: "place", end: 2, engaged: false, requires: [], scene: "b", scene_after: "b", switches: []}];
  const it = await planned(undefined, {check: async (plan) => ({...plan, refused: "", covered: {segments}})});
  const text = it.text(".verdict-segments");
  assert.match(text, /1\. fetch, 0\.0 s to 1\.0 s\. In contact.*Needs held off\. At its end: vacuum on; goes on when held on\./);
  assert.deepEqual([...it.document.querySelectorAll(".playback-segments li")].map((item) => item.firstChild.textContent), ["fetch", "place"]);
  assert.equal(it.text(".playback-switch"), "vacuum on");
});

// -- playback

test("the slider shows the plan at its time, and the present again on request", async () => {
  const it = await planned([playback]);
  it.enter(it.find(".playback-slider"), "1");
  assert.deepEqual(it.store.robot("kr120").playback.names, PLAN.joints);
  assert.ok(Math.abs(it.store.robot("kr120").playback.positions[0] - 0.5) < 1e-12);
  assert.equal(it.text(".playback-time"), "1.0 s of 2.0 s");
  it.click(it.find(".playback-present"));
  assert.equal(it.store.robot("kr120").playback, null);
});

test("playing goes at the chosen speed and ends at the end", async () => {
  const it = await planned([playback]);
  it.choose(it.find(".playback-speed"), "2");
  it.click(it.find(".playback-play"));
  await it.pass(500);
  assert.ok(Math.abs(it.store.robot("kr120").playback.time - 1) < 0.1);
  await it.pass(600);
  assert.equal(it.store.robot("kr120").playback.time, 2);
  assert.equal(it.text(".playback-play"), "Play");
});

test("a plan that is taken away is not shown any longer", async () => {
  const it = await planned([playback]);
  it.click(it.find(".playback-play"));
  await it.pass(200);
  await it.hear("kr120", "plan", null);
  assert.equal(it.store.robot("kr120").playback, null);
  assert.equal(it.find(".playback").hidden, true);
});

// -- stop

test("a stop goes out when the finger touches, and its answers are shown", async () => {
  const it = await page([stop]);
  await it.hear("kr120", "view", view());
  it.fire(it.find(".stop-stop"), "pointerdown", {button: 0});
  await it.settle();
  const [{topic, robot, qos, payload}] = it.connection.sent;
  assert.deepEqual([topic, robot, qos], ["stop/ada", "kr120", 1]);
  // the click that follows the touch is not a second stop
  it.fire(it.find(".stop-stop"), "click", {detail: 1});
  assert.equal(it.connection.sent.length, 1);
  await it.hear("kr120", "stop/ack", {id: payload.id, account: "ada", ok: true, reason: "braking", by: "gateway"});
  assert.match(it.text(".stop-result"), /^14:05:12 Stop: carried out\. Controller side: braking/);
});

test("a stop by the keyboard goes out once", async () => {
  const it = await page([stop]);
  await it.hear("kr120", "view", view());
  it.fire(it.find(".stop-stop"), "click", {detail: 0});
  await it.settle();
  assert.equal(it.connection.sent.length, 1);
});

test("a stop without a connection says in red that it did not go out", async () => {
  const it = await page([stop]);
  await it.hear("kr120", "view", view());
  it.connection.change("lost", "closed");
  it.fire(it.find(".stop-stop"), "pointerdown", {button: 0});
  await it.settle();
  assert.match(it.text(".stop-result"), /did NOT go out/);
  assert.ok(it.find(".stop-result").classList.contains("is-bad"));
  assert.equal(it.find(".stop-result").getAttribute("role"), "alert");
  assert.equal(it.find(".stop-stop").disabled, false);
});

test("beside the buttons stands that nothing goes out, before somebody relies on them", async () => {
  const it = await page([stop]);
  assert.equal(it.find(".stop-offline").hidden, true);
  it.connection.change("lost", "silent");
  assert.equal(it.find(".stop-offline").hidden, false);
  assert.match(it.text(".stop-offline"), /nothing that is pressed here goes out/);
  it.connection.change("connected");
  assert.equal(it.find(".stop-offline").hidden, true);
});

test("a resume repeats what the page had shown; one that was too late says so, and a stop repeats nothing", async () => {
  const it = await page([stop]);
  await it.hear("kr120", "view", view());
  it.click(it.find(".stop-resume"));
  await it.settle();
  const [{topic, payload}] = it.connection.sent;
  assert.deepEqual([topic, payload], ["resume/ada", {id: payload.id, moment: it.store.moment("kr120")}]);
  await it.hear("kr120", "pause/ack", {id: payload.id, account: "ada", ok: false, expired: true, reason: "the resume is too old", by: "executor"});
  assert.match(it.text(".stop-result"), /Resume does NOT count: what this page had shown was too old.*Look again.*emergency stop/);
  assert.ok(it.find(".stop-result").classList.contains("is-bad"));
  assert.equal(it.find(".stop-resume").disabled, false);
  it.fire(it.find(".stop-stop"), "pointerdown", {button: 0});
  await it.settle();
  assert.deepEqual(Object.keys(it.connection.sent[1].payload), ["id"]);
});

test("a resume does not go out while the page knows nothing of the robot, and a stop does", async () => {
  const it = await page([stop]);
  await it.hear("kr120", "view", view());
  it.connection.change("lost");
  it.connection.change("connected");
  it.click(it.find(".stop-resume"));
  await it.settle();
  assert.deepEqual(it.connection.sent, []);
  assert.match(it.text(".stop-result"), /Look again, then press anew/);
  it.fire(it.find(".stop-stop"), "pointerdown", {button: 0});
  await it.settle();
  assert.equal(it.connection.sent.length, 1);
});

test("a stop that nobody answers within a second says so", async () => {
  const it = await page([stop]);
  await it.hear("kr120", "view", view());
  it.fire(it.find(".stop-stop"), "pointerdown", {button: 0});
  await it.pass(900);
  assert.doesNotMatch(it.text(".stop-result"), /NO ANSWER/);
  await it.pass(200);
  assert.match(it.text(".stop-result"), /NO ANSWER/);
});

test("a stop that the broker refuses says that the right is missing", async () => {
  const it = await page([stop]);
  await it.hear("kr120", "view", view());
  it.connection.refuse("refused");
  it.click(it.find(".stop-pause"));
  await it.settle();
  assert.match(it.text(".stop-result"), /Pause did NOT go out: this account does not have the right/);
});

test("the buttons are there before any robot is, and for each robot of two", async () => {
  const it = await page([stop]);
  it.fire(it.find(".stop-stop"), "pointerdown", {button: 0});
  await it.settle();
  assert.match(it.text(".stop-result"), /did NOT go out/);
  await it.hear("kr120", "view", view());
  // it did not go out to the robot that is known since, either
  assert.match(it.text(".stop-result"), /did NOT go out/);
  await it.hear("kr6", "view", view());
  const labels = [...it.document.querySelectorAll(".stop-stop")].map((each) => each.getAttribute("aria-label"));
  assert.deepEqual(labels, [null, "Stop kr120", "Stop kr6"]);
  it.fire(it.document.querySelectorAll(".stop-stop")[2], "pointerdown", {button: 0});
  await it.settle();
  assert.equal(it.connection.sent[0].robot, "kr6");
  // one for all: a stop for each, and an answer of each
  it.fire(it.find(".stop-all"), "pointerdown", {button: 0});
  await it.settle();
  assert.deepEqual(it.connection.sent.slice(1).map(({robot, topic}) => [robot, topic]), [["kr120", "stop/ada"], ["kr6", "stop/ada"]]);
  const [, second, third] = it.connection.sent.map(({payload}) => payload.id);
  assert.notEqual(second, third);
  await it.hear("kr6", "stop/ack", {id: third, account: "ada", ok: true, reason: "braked", by: "gateway", expired: false});
  const lines = [...it.document.querySelectorAll(".stop-result")].map((each) => each.textContent);
  assert.match(lines[0], /Stop kr120: sent, no answer yet/);
  assert.match(lines[1], /Stop kr6: carried out/);
  assert.match(it.text(".stop-not-emergency"), /not an emergency stop/);
});

// -- status

test("the worst line comes first and large, with whom it waits for and what to do", async () => {
  const it = await page([status]);
  await it.hear("kr120", "view", view());
  await it.hear("kr120", "screen", [{...LINE, topic: "link", level: 2, sentence: "The arm was stopped, and holds.", waits_for: "a reset", who: "operator",
    todo: "remove the cause", page: "troubleshooting.md#needs_reset-call-reset"}, LINE]);
  assert.match(it.text(".status-worst"), /The arm was stopped, and holds\.Waits for: a reset \(a person at the cell\)To do: remove the cause/);
  assert.ok(it.find(".status-worst").classList.contains("is-fault"));
  assert.equal(it.find(".status-worst a").getAttribute("href"), "docs/troubleshooting.html#needs_reset-call-reset");
  assert.match(it.text(".status-list"), /The arm holds its pose/);
  assert.equal(it.find(".status-own").hidden, true);
});

test("in another language the robot's sentences are in the page's words, with the reason as the robot says it", async () => {
  const it = await page([status], {language: "de"});
  await it.hear("kr120", "view", view());
  const sentence = "Waits for: the arm waits for 3 deg";
  const line = {...LINE, topic: "link", state: "NEEDS_RESET", level: 2, sentence, waits_for: "a reset", who: "operator", todo: "remove the cause",
    said: {[sentence]: {template: "Waits for: {what}", values: {what: "the arm waits for 3 deg"}}}};
  await it.hear("kr120", "screen", [line]);
  assert.equal(it.text(".status-worst .status-sentence"), "Wartet auf: the arm waits for 3 °");
  assert.match(it.text(".status-worst"), /Verbindung zum Arm.*Wartet auf: ein Zurücksetzen \(reset\) \(jemand an der Zelle\)Zu tun: remove the cause/);
});

test("what this page has no words for is the robot's own", async () => {
  const it = await page([status], {language: "de"});
  await it.hear("kr120", "view", view());
  const line = {...LINE, sentence: "It rains.", topic: "weather", state: "UNHEARD", waits_for: "rain", who: "cloud", todo: "wait"};
  await it.hear("kr120", "screen", [line]);
  assert.match(it.text(".status-worst"), /weatherIt rains\.Wartet auf: rain \(cloud\)Zu tun: wait/);
  // what is no line at all does not come this far, and what was said before stays
  for (const bad of [{todo: 3}, {level: "2"}]) await it.hear("kr120", "screen", [{...line, waits_for: "snow", ...bad}]);
  assert.equal(it.store.refused, 2);
  assert.match(it.text(".status-worst"), /Wartet auf: rain/);
});

test("a page of the docs leads nowhere else", () => {
  for (const page of ["javascript:alert(1)", "https://example.org/x.md", "../secret.md", "/etc/x.md", "x.html", "a.md?b", "", null, 3, "//x/y.md"]) {
    assert.equal(status.addressOf(page), "", String(page));
    assert.equal(status.addressOf(page, "de", {de: [page]}), "", String(page));
  }
  assert.equal(status.addressOf("reference/states.md#execution"), "docs/reference/states.html#execution");
});

test("a page of the docs is one below docs/, and nothing else", () => {
  assert.equal(status.addressOf("reference/states.md#execution"), "docs/reference/states.html#execution");
  assert.equal(status.addressOf("planning.md"), "docs/planning.html");
  for (const page of ["", "https://elsewhere/x.md", "../x.md", "x.html"]) assert.equal(status.addressOf(page), "");
});

test("what was heard is shown as old after a second, and a lost connection at once", async () => {
  const it = await page([status]);
  await it.hear("kr120", "view", view());
  await it.hear("kr120", "screen", [LINE]);
  assert.equal(it.find(".status-own").hidden, true);
  await it.pass(1300, 50, false);
  assert.match(it.text(".status-own"), /Old: nothing was heard for 1 s/);
  assert.ok(it.find("main").classList.contains("is-past"));
  it.connection.change("lost", "broker_away");
  assert.match(it.text(".status-own"), /Not connected/);
  assert.equal(it.find(".status-worst").hidden, true);
});

test("sentences that stopped coming are told to be old", async () => {
  const it = await page([status]);
  await it.hear("kr120", "view", view());
  await it.hear("kr120", "screen", [LINE]);
  await it.pass(4500);
  assert.match(it.text(".status-own"), /4 s old/);
});

test("a sentence with markup is text", async () => {
  const it = await page([status]);
  await it.hear("kr120", "view", view());
  await it.hear("kr120", "screen", [{...LINE, sentence: "<img src=x onerror=alert(1)>"}]);
  assert.equal(it.document.querySelector("img"), null);
  assert.match(it.text(".status-sentence"), /<img/);
});

test("the plan of a task is named as in the list of tasks, and the whole of who asks is among the checks", async () => {
  const source = "'Place stud 1' (0l7PAfCbzQORIUotwsG0jI) by +z 0 mm along, 6 cups, offer d495";
  const it = await page([playback, verdict]);
  await it.hear("kr120", "view", view({plan: "p1"}));
  await it.hear("kr120", "plan", {...PLAN, task: "0l7PAfCbzQORIUotwsG0jI", source}, true);
  assert.equal(it.text(".verdict-title"), "Plan of the task 0l7PAfCbzQORIUotwsG0jI");
  // the list may come after the plan
  const task = {id: "0l7PAfCbzQORIUotwsG0jI", name: "Place stud 1", element: "e", element_name: "Stud 1", state: "planned", reason: "",
    after: [], robot: "", plan_id: "p1", deviation_mm: null, deviation_deg: null, question: "", answers: []};
  await it.hear("kr120", "work/tasks", work({tasks: [task]}), true);
  assert.equal(it.text(".verdict-title"), "Plan of the task Place stud 1");
  const rows = [...it.document.querySelectorAll(".verdict-checks dd")].map((row) => row.textContent);
  assert.ok(rows.includes(source) && rows.includes("0l7PAfCbzQORIUotwsG0jI"));
});
