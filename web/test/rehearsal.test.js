import assert from "node:assert/strict";
import {test} from "node:test";
import * as verdict from "../src/panels/verdict.js";
import {fakePage, plan, view} from "./support/fake.js";

const AXIS = {joint: "A1", peak: 1000, time: 0.5, rms: 400, gravity: 0.25, limit: 4000, estimated: true};
const REHEARSAL = {
  plan_id: "p1", plan_hash: "h1", scene: "5ce9e0", tool: "t", inputs: "i", state: "passed", reasons: [],
  axes: [AXIS, {...AXIS, joint: "joint_a2", peak: 1830, limit: 3000, estimated: false}, {...AXIS, joint: "A3", limit: 0}],
  payload: {mass: 42, estimated: true, across: 0, along: 0.2, inertia: 1, rated_mass: 120, rated_inertia: 0, rated_across: 0, rated_along: 0},
  tracking: 0.001, tracking_joint: "A1", braking: {time: 1.2, seconds: 0.5, distance: 0.321, joint: "A1", angle: 0.2, usage: 0.44},
  worst_time: 1, worst_pose: [0, 0], contacts: [], objects: [], grip: {name: "board", cups: 4, time: 0.8, usage: 0.62}, energy: 10, duration: 2, took: 0.2, settle_took: 0, engine: "MuJoCo 4",
  remarks: [], hash: "f00d", stamp: 1.5,
};

/** The verdict's panel with a plan under review, and what was found of a rehearsal. */
async function panel(rehearsal, language = "en") {
  const fake = fakePage({account: "ada", language});
  verdict.make(fake.parent, fake.store, fake.connection, fake.texts, {now: () => fake.clock.now, every: () => {}});
  await fake.hear("kr120", "plan", plan());
  if (rehearsal !== null) await fake.hear("kr120", "rehearsal", rehearsal);
  return {...fake, find: (selector) => fake.document.querySelector(selector), all: (selector) => [...fake.document.querySelectorAll(selector)]};
}

test("one line says that it passed, and the axis that uses most; opened, each axis has its bar", async () => {
  const page = await panel(REHEARSAL);
  const part = page.find(".rehearsal");
  assert.equal(part.hidden, false);
  assert.equal(part.querySelector("summary").textContent, "Rehearsed: passed, largest torque 61 % (A2)");
  assert.equal(page.find(".rehearsal-why").hidden, true);
  const bars = page.all(".rehearsal-axes li");
  assert.equal(bars.length, 3);
  assert.match(bars[0].textContent, /A1: 1000 of 4000~ Nm, 25 %/);
  assert.equal(bars[1].querySelector(".rehearsal-bar").style.getPropertyValue("--used"), "0.610");
  assert.match(bars[2].textContent, /limit not known/);
  assert.match(page.find(".rehearsal-found").textContent, /42\.0~ kg of 120\.0 kg/);
  assert.match(page.find(".rehearsal-found").textContent, /The drives put in 0\.01 kJ/);
  assert.match(page.find(".rehearsal-found").textContent, /Simulated by MuJoCo 4/);
});

test("of one that failed the reasons stand below the line, in the page's language", async () => {
  const reason = "Waits for: a lighter load";
  const said = {[reason]: {template: "Waits for: {what}", values: {what: "a lighter load"}}};
  const page = await panel({...REHEARSAL, state: "failed", reasons: [reason], said}, "de");
  assert.equal(page.find(".rehearsal summary").textContent, "Geprobt: nicht bestanden");
  assert.equal(page.find(".rehearsal summary").className, "is-bad");
  assert.deepEqual(page.all(".rehearsal-why li").map((item) => item.textContent), ["Wartet auf: a lighter load"]);
});

test("one that broke off has no axes and says so", async () => {
  const page = await panel({...REHEARSAL, state: "broken", reasons: ["x"], axes: [], engine: "", tracking: null, energy: null});
  assert.equal(page.find(".rehearsal summary").textContent, "The rehearsal broke off");
  assert.equal(page.all(".rehearsal-axes li, .rehearsal-found li").length, 0);
});

for (const [what, changes] of Object.entries({"plan": {plan_id: "p0"}, "hash": {plan_hash: "h0"}, "scene": {scene: "ca5cade"}, "tool": {tool: "u"}, "tool, none": {tool: ""}})) {
  test(`one of another ${what} is not shown`, async () => {
    const page = await panel({...REHEARSAL, ...changes});
    assert.equal(page.find(".rehearsal").hidden, true);
  });
}

test("without a tool one counts that was made without a tool, and no other", async () => {
  for (const [tool, hidden] of [["", false], ["t", true]]) {
    const page = await panel(null);
    await page.hear("kr120", "plan", {...plan(), tool: undefined});
    await page.hear("kr120", "rehearsal", {...REHEARSAL, tool});
    assert.equal(page.find(".rehearsal").hidden, hidden);
  }
});

test("it goes when the broker has none any more", async () => {
  const page = await panel(REHEARSAL);
  await page.store.take("kr120", "rehearsal", "");
  assert.equal(page.find(".rehearsal").hidden, true);
});

test("a message that is no rehearsal is refused", async () => {
  const page = await panel({...REHEARSAL, axes: "many"});
  assert.equal(page.find(".rehearsal").hidden, true);
  assert.equal(page.store.refused, 1);
});

// -- in spite of it

const AGAINST = "plan p1 has failed its rehearsal: the flange carries 240.0 kg; the arm is rated for 120.0 kg";
const FAILED = {...REHEARSAL, state: "failed", reasons: ["the flange carries 240.0 kg; the arm is rated for 120.0 kg"]};
/** Who has the right, and the name of the account. */
const RIGHTS = {approve: {ada: "ada", grace: "Grace"}};

/** A page whose plan was looked at and is held back by its rehearsal, or by what `obstacle` says. */
async function held({account = "ada", language = "en", obstacle = AGAINST, rights = RIGHTS, rehearsal = FAILED} = {}) {
  const fake = fakePage({account, language});
  const timers = [];
  if (rights !== null) {
    fake.store.rightsOf = {
      may: (_, right) => (rights[right] ? Object.hasOwn(rights[right], account) : null),
      who: (_, right) => Object.entries(rights[right] ?? {}).filter(([one]) => one !== account).map(([, name]) => name),
    };
  }
  verdict.make(fake.parent, fake.store, fake.connection, fake.texts, {now: () => fake.clock.now, every: (_, call) => timers.push(call)});
  const find = (selector) => fake.document.querySelector(selector);
  const fire = (element, type, values = {}) => element.dispatchEvent(Object.assign(new fake.window.Event(type, {bubbles: true}), values));
  const say = (against) => fake.hear("kr120", "view", view({plan: "p1", approval_obstacle: against, overridable: against.startsWith("plan p1")}));
  await say(obstacle);
  await fake.hear("kr120", "plan", plan());
  if (rehearsal !== null) await fake.hear("kr120", "rehearsal", rehearsal);
  const pass = async (ms, against = obstacle) => {
    for (let gone = 0; gone < ms; gone += 50) {
      fake.later(50);
      await say(against);
      fake.store.set("looked", "kr120", {what: "shown", hash: "h1"});
      for (const call of timers) call();
      await new Promise((resolve) => setImmediate(resolve));
    }
  };
  const press = () => fire(find(".override-approve"), "pointerdown", {button: 0});
  fake.store.set("looked", "kr120", {what: "checks", hash: "h1"});
  await pass(1200);
  return {...fake, find, fire, pass, press, text: (selector) => find(selector).textContent,
    give: () => fake.enter(find(".override input"), "the drives' file is an estimate")};
}

for (const language of ["en", "de"]) {
  test(`who may approves in spite of the rehearsal with a reason, by a press of a second, in ${language}`, async () => {
    const it = await held({language});
    assert.equal(it.find(".override").hidden, false);
    assert.equal(it.find(".verdict-approve").disabled, true);
    // without a reason a finger does nothing
    assert.equal(it.find(".override-approve").disabled, true);
    assert.equal(it.text(".override-hint"), it.texts("Say why, then the plan can be approved in spite of its rehearsal."));
    it.press();
    await it.pass(1200);
    assert.deepEqual(it.connection.sent, []);
    it.give();
    it.press();
    await it.pass(900);
    assert.deepEqual(it.connection.sent, []);
    await it.pass(200);
    assert.deepEqual(it.connection.sent.map(({topic, payload}) => [topic, payload.verdict, payload.reason, payload.rehearsal_hash]),
      [["override_rehearsal/ada", "approved", "the drives' file is an estimate", "f00d"]]);
    await it.hear("kr120", "override_rehearsal/ack",
      {account: "ada", reviewer: "ada", plan_id: "p1", plan_hash: "h1", verdict: "approved", ok: true, reason: "it moves"});
    assert.match(it.text(".verdict-notice"), /it moves/);
    assert.equal(it.find(".override").hidden, true);
  });
}

test("a press that is let go too early, or that meets another word of the rehearsal, sends nothing", async () => {
  const it = await held();
  it.give();
  it.press();
  await it.pass(500);
  it.fire(it.find(".override-approve"), "pointerup");
  assert.equal(it.text(".verdict-notice"), it.texts("Not approved: the button was released before the second was over."));
  it.press();
  await it.pass(500);
  await it.pass(1500, "plan p1 could not be rehearsed: it took too long");
  assert.equal(it.text(".verdict-notice"), it.texts("Not approved: what the rehearsal says has changed while the button was held."));
  // and it has passed after all
  it.press();
  await it.pass(500, "plan p1 could not be rehearsed: it took too long");
  await it.pass(1500, "");
  assert.equal(it.text(".verdict-notice"), it.texts("Not approved: what the rehearsal says has changed while the button was held."));
  assert.equal(it.find(".override").hidden, true);
  assert.deepEqual(it.connection.sent, []);
});

test("who may not is told who can approve, and is offered nothing; where nobody is listed that is said", async () => {
  const it = await held({account: "vic"});
  assert.equal(it.find(".override").hidden, true);
  assert.equal(it.text(".verdict-hint"), "This account may not approve. Who can: ada, Grace.");
  it.give();
  it.press();
  await it.pass(1500);
  assert.deepEqual(it.connection.sent, []);
  const none = await held({account: "vic", rights: {approve: {}}});
  assert.equal(none.text(".verdict-hint"), "This account may not approve. Nobody is listed who can; at the robot's computer it can be done.");
});

for (const obstacle of ["", "the executor is EXECUTING: a plan is played"]) {
  test(`what a rehearsal does not hold back cannot be approved so: "${obstacle}"`, async () => {
    const it = await held({obstacle});
    assert.equal(it.find(".override").hidden, true);
    it.give();
    it.press();
    await it.pass(1500);
    assert.deepEqual(it.connection.sent, []);
  });
}

for (const [what, rehearsal] of Object.entries({"at all": null, "of this plan": {...FAILED, plan_hash: "h0"}})) {
  test(`without a rehearsal ${what} it is offered where one is required, and says that none was seen`, async () => {
    const it = await held({obstacle: "plan p1 was not rehearsed yet, and it must be", rehearsal});
    assert.equal(it.find(".override").hidden, false);
    it.give();
    it.press();
    await it.pass(1100);
    assert.deepEqual(it.connection.sent.map(({payload}) => payload.rehearsal_hash), [""]);
  });
}

for (const [what, before, after] of [["comes", null, FAILED], ["replaces another", FAILED, {...FAILED, hash: "2nd"}]]) {
  test(`a result that ${what} while the button is held ends the press, also where the sentence is the same`, async () => {
    const it = await held({rehearsal: before});
    it.give();
    it.press();
    await it.pass(500);
    await it.hear("kr120", "rehearsal", after);
    await it.pass(1500);
    assert.deepEqual(it.connection.sent, []);
    assert.equal(it.text(".verdict-notice"), it.texts("Not approved: what the rehearsal says has changed while the button was held."));
    // what is shown now is what a second press is about
    it.press();
    await it.pass(1100);
    assert.deepEqual(it.connection.sent.map(({payload}) => payload.rehearsal_hash), [after.hash]);
  });
}

test("what the executor or the broker refuses is told, and can be asked again", async () => {
  const it = await held();
  it.give();
  it.press();
  await it.pass(1100);
  await it.hear("kr120", "override_rehearsal/ack",
    {account: "ada", reviewer: "ada", plan_id: "p1", plan_hash: "h1", verdict: "approved", ok: false, reason: "not now"});
  assert.match(it.text(".verdict-notice"), /NOT accepted: not now/);
  it.connection.refuse("refused");
  it.press();
  await it.pass(1200);
  assert.equal(it.text(".verdict-notice"), "Approval did NOT go out: this account does not have the right.");
});

test("on a broker without accounts the console's own account asks, and the typed name goes with it", async () => {
  const it = await held({account: "", rights: null});
  it.enter(it.find(".verdict-name input"), "Ada");
  it.give();
  it.press();
  await it.pass(1100);
  assert.deepEqual(it.connection.sent.map(({topic, payload}) => [topic, payload.reviewer]), [["override_rehearsal/console", "Ada"]]);
  await it.hear("kr120", "override_rehearsal/ack",
    {account: "console", reviewer: "console", plan_id: "p1", plan_hash: "h1", verdict: "approved", ok: true, reason: "it moves"});
  assert.match(it.text(".verdict-notice"), /accepted. it moves/);
});
