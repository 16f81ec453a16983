import assert from "node:assert/strict";
import {test} from "node:test";
import * as verdict from "../src/panels/verdict.js";
import {fakePage, plan} from "./support/fake.js";

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
});

test("of one that failed the reasons stand below the line, in the page's language", async () => {
  const reason = "the flange carries 240.0 kg; the arm is rated for 120.0 kg";
  const page = await panel({...REHEARSAL, state: "failed", reasons: [reason]}, "de");
  assert.equal(page.find(".rehearsal summary").textContent, "Geprobt: nicht bestanden");
  assert.equal(page.find(".rehearsal summary").className, "is-bad");
  assert.deepEqual(page.all(".rehearsal-why li").map((item) => item.textContent), ["am Flansch hängen 240.0 kg; der Arm ist für 120.0 kg bemessen"]);
});

test("one that broke off has no axes and says so", async () => {
  const page = await panel({...REHEARSAL, state: "broken", reasons: ["x"], axes: [], engine: "", tracking: null, energy: null});
  assert.equal(page.find(".rehearsal summary").textContent, "The rehearsal broke off");
  assert.equal(page.all(".rehearsal-axes li, .rehearsal-found li").length, 0);
});

for (const [what, changes] of Object.entries({"plan": {plan_id: "p0"}, "hash": {plan_hash: "h0"}})) {
  test(`one of another ${what} is not shown`, async () => {
    const page = await panel({...REHEARSAL, ...changes});
    assert.equal(page.find(".rehearsal").hidden, true);
  });
}

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
