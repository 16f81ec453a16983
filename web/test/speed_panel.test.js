import assert from "node:assert/strict";
import {test} from "node:test";
import * as speed from "../src/panels/speed.js";
import {HELD_FOR} from "../src/hold.js";
import {PACE} from "../src/speed_state.js";
import {fakePage, view} from "./support/fake.js";

const said = (changes = {}) => ({limit: 1, by: "", reason: "nobody limits the speed", people: 1, person: "", since: 0, replaced: 1, replaced_person: "", ...changes});
const byDora = (limit, changes = {}) => said({
  limit, by: "people", people: limit, person: "dora", since: 1000, reason: `dora has limited the speed to ${Math.round(100 * limit)}%`, ...changes,
});

async function page(options = {}, first = said()) {
  const fake = fakePage({account: "dora", ...options});
  const timers = [];
  const clock = {now: () => fake.clock.now, every: (_ms, call) => timers.push(call), time: () => "14:05:12"};
  speed.make(fake.parent, fake.store, fake.connection, fake.texts, clock);
  let shown = first;
  const settle = () => new Promise((resolve) => setImmediate(resolve));
  const says = async (next) => {
    shown = next;
    await fake.hear("kr120", "view", view({speed: shown}));
  };
  const pass = async (ms) => {
    for (let k = 0; k < ms; k += 50) {
      fake.later(50);
      if (fake.connection.state === "connected") await says(shown);
      for (const call of timers) call();
      await settle();
    }
  };
  const find = (selector) => fake.document.querySelector(selector);
  const fire = (element, type, values = {}) => {
    const event = new fake.window.Event(type, {bubbles: true, cancelable: true});
    Object.assign(event, values);
    element.dispatchEvent(event);
  };
  const drag = (percent) => {
    find(".speed-slider").value = String(percent);
    fire(find(".speed-slider"), "input");
  };
  await says(first);
  const payloads = () => fake.connection.sent.map(({payload}) => payload);
  return {...fake, says, pass, find, fire, drag, settle, payloads, text: (selector) => find(selector).textContent, step: (k) => fake.click([...fake.document.querySelectorAll(".speed-step")][k])};
}

test("it says what is in force as the robot says it, and who set it", async () => {
  const it = await page();
  assert.equal(it.text(".speed-now"), "No speed limit: as fast as planned.");
  assert.equal(it.find(".speed-who").hidden, true);
  await it.says(byDora(0.3, {replaced: 0.8, replaced_person: "bob"}));
  assert.equal(it.text(".speed-now"), "Speed limit in force: 30 % of the planned speed (dora has limited the speed to 30%).");
  assert.match(it.text(".speed-who"), /^People's limit: 30 %, set by dora on .*; before: 80 % \(bob\)\.$/);
  await it.says(byDora(0.3, {limit: 0, by: "program", reason: "speed limit 0 by /kr120/separation: a person is near"}));
  assert.match(it.text(".speed-now"), /^Speed limit in force: 0 % .* by a program .*a person is near/);
  assert.equal(it.find(".speed-slider").value, "30", "the slider is the people's");
  await it.says(null);
  assert.equal(it.text(".speed-now"), "Speed limit in force: 100 % of the planned speed.");
});

test("lowering goes out at once while dragging, paced, without a moment", async () => {
  const it = await page();
  it.drag(80);
  for (const percent of [70, 60, 50]) it.drag(percent);
  assert.deepEqual(it.payloads().map(({limit}) => limit), [0.8]);
  await it.pass(PACE + 50);
  assert.deepEqual(it.payloads().map(({limit}) => limit), [0.8, 0.5]);
  const {topic, robot, payload, qos} = it.connection.sent[1];
  assert.deepEqual([topic, robot, qos, Object.keys(payload)], ["lower_speed/dora", "kr120", 1, ["id", "limit"]]);
  await it.hear("kr120", "speed/ack", {id: payload.id, account: "dora", limit: 0.5, ok: true, reason: "it is lowered", expired: false});
  assert.equal(it.text(".speed-result"), "14:05:12 Lower to 50 %: carried out. it is lowered");
});

test("the buttons are a step each: one lowers at once, one asks", async () => {
  const it = await page({}, byDora(0.5));
  it.step(0);
  assert.deepEqual(it.payloads().map(({limit}) => limit), [0.45]);
  await it.says(byDora(0.45));
  it.step(1);
  it.step(1);
  await it.pass(500);
  assert.equal(it.payloads().length, 1);
  assert.equal(it.find(".speed-raise").hidden, false);
  assert.equal(it.text(".speed-raise .hold-text"), "Hold for a second: raise to 55 %");
});

test("raising is a hold of a second, and repeats the newest moment", async () => {
  const it = await page({}, byDora(0.5));
  it.drag(80);
  it.fire(it.find(".speed-raise"), "pointerdown", {button: 0});
  await it.pass(HELD_FOR - 100);
  assert.equal(it.payloads().length, 0);
  await it.pass(150);
  const [payload] = it.payloads();
  assert.equal(payload.limit, 0.8);
  const [seen, newest] = [payload.moment, it.store.moment("kr120")].map((moment) => Number(moment.split("-")[1]));
  assert.ok(seen <= newest && newest - seen <= 80, "of the view that came when the hold was over");
  await it.hear("kr120", "speed/ack", {id: payload.id, account: "dora", limit: 0.5, ok: false, reason: "the raise is too old", expired: true});
  assert.match(it.text(".speed-result"), /Raise to 80 % does NOT count: what this page had shown was too old/);
  assert.match(it.find(".speed-result").className, /is-bad/);
});

test("letting go, another limit or a lost connection ends a hold", async () => {
  for (const end of [
    (it) => it.fire(it.find(".speed-raise"), "pointerup"),
    (it) => it.fire(it.find(".speed-raise"), "pointerleave"),
    (it) => it.says(byDora(0.4)),
    (it) => it.connection.change("lost", "closed"),
    (it) => it.fire(it.document, "visibilitychange"),
  ]) {
    const it = await page({}, byDora(0.5));
    it.drag(80);
    it.fire(it.find(".speed-raise"), "pointerdown", {button: 0});
    await it.pass(500);
    await end(it);
    await it.pass(1000);
    assert.equal(it.payloads().length, 0);
  }
});

test("the keyboard holds, too, and a key that repeats is one hold", async () => {
  const it = await page({}, byDora(0.5));
  it.step(1);
  it.fire(it.find(".speed-raise"), "keydown", {key: " "});
  for (let k = 0; k < 6; k += 1) {
    await it.pass(200);
    it.fire(it.find(".speed-raise"), "keydown", {key: " ", repeat: true});
  }
  assert.deepEqual(it.payloads().map(({limit}) => limit), [0.55]);
});

test("without a connection nothing can be set, and it is said", async () => {
  const it = await page();
  it.connection.change("lost", "closed");
  // without a connection nothing of the robot is known
  assert.equal(it.find(".speed").hidden, true);
  it.connection.change("connected");
  await it.says(said());
  assert.equal(it.find(".speed-slider").disabled, false);
  await it.pass(50);
  it.later(2000);
  assert.equal(it.find(".speed-slider").disabled, true);
  assert.match(it.text(".speed-hint"), /Nothing of the robot is shown now/);
});

test("a broker that refuses it is told, and the handle stands where the robot's limit is", async () => {
  const it = await page();
  it.connection.refuse("refused");
  it.drag(50);
  await it.settle();
  assert.match(it.text(".speed-result"), /did NOT go out: this account does not have the right/);
  assert.equal(it.find(".speed-slider").value, "100");
});

for (const [right, percent, other, only] of [["operate", 50, 90, /may lower the limit, not raise it/], ["approve", 90, 50, /may raise the limit, not lower it/]]) {
  test(`an account with the right ${right} alone sets it one way`, async () => {
    const it = await page({}, byDora(0.8));
    it.store.rightsOf = {may: (_, each) => each === right, who: () => []};
    it.store.rights({});
    assert.match(it.text(".speed-hint"), only);
    it.drag(other);
    assert.equal(it.find(".speed-slider").value, "80");
    it.drag(percent);
    it.fire(it.find(".speed-raise"), "pointerdown", {button: 0});
    await it.pass(1100);
    assert.deepEqual(it.payloads().map(({limit}) => limit), [percent / 100]);
  });
}

test("a second without an answer is told", async () => {
  const it = await page();
  it.drag(50);
  await it.pass(1100);
  assert.match(it.text(".speed-result"), /NO ANSWER/);
});

test("it speaks German", async () => {
  const it = await page({language: "de"});
  const template = "{person} has limited the speed to {percent:.0f}%";
  const limit = byDora(0.3);
  await it.hear("kr120", "view", view({speed: limit, said: {[limit.reason]: {template, values: {person: "dora", percent: "30"}}}}));
  assert.equal(it.text(".speed-now"), "Es gelten höchstens 30 % der geplanten Geschwindigkeit (dora hat die Geschwindigkeit auf 30 % begrenzt).");
});
