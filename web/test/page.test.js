/** The frame: what becomes of the others when one panel has an exception. */
import assert from "node:assert/strict";
import {test} from "node:test";
import {makePage} from "../src/page.js";
import * as playback from "../src/panels/playback.js";
import * as status from "../src/panels/status.js";
import * as stop from "../src/panels/stop.js";
import * as verdict from "../src/panels/verdict.js";
import {fakePage, plan, view} from "./support/fake.js";

/** A page with these panels in its areas; `reported` holds the exceptions. */
function framed(panels, options = {}) {
  const reported = [];
  const page = fakePage({account: "ada", report: (error) => reported.push(error), ...options});
  makePage(page.document.body, page.store, page.connection, page.texts, panels);
  const find = (selector) => page.document.querySelector(selector);
  return {...page, reported, find, text: (selector) => find(selector).textContent};
}

/** A real panel, with a clock that the test holds: `held.at` [ms], and `held.timers` to call. */
function real(module, held = {at: 0, timers: []}) {
  const clock = {now: () => held.at, every: (ms, call) => held.timers.push(call), frame: () => {}, time: () => "14:05:12"};
  return {make: (parent, store, connection, texts) => module.make(parent, store, connection, texts, clock)};
}

const broken = {
  make() {
    throw new TypeError("no picture");
  },
};
const fails = (kind) => ({
  make(parent, store) {
    store.on(kind, () => {
      throw new TypeError("no such body");
    });
  },
});

for (const [language, sentence] of [["en", /^A part of this page has failed \(Picture\).*Reload the page\.$/], ["de", /\(Bild\).*Laden Sie die Seite neu\.$/]]) {
  test(`a panel that cannot be made is told, and the others are there: ${language}`, () => {
    const it = framed({picture: broken, stop: real(stop), status: real(status)}, {language});
    assert.ok(it.find("#stop .stop-stop") && it.find("#status .status-own"));
    assert.equal(it.find(".failed").hidden, false);
    assert.match(it.text(".failed"), sentence);
    assert.equal(it.find(".failed").getAttribute("role"), "alert");
    assert.deepEqual(it.reported.map(String), ["TypeError: no picture"]);
  });
}

test("a panel that fails with each view is told once, and stop and state go on", async () => {
  const it = framed({picture: fails("view"), stop: real(stop), status: real(status)});
  for (let k = 0; k < 3; k += 1) await it.hear("kr120", "view", view());
  await it.hear("kr120", "screen", [{topic: "execution", state: "IDLE", level: 0, sentence: "The arm holds."}]);
  assert.match(it.text("#status"), /The arm holds\./);
  assert.equal(it.find("#stop .stop-stop").getAttribute("aria-label"), "Stop kr120");
  assert.match(it.text(".failed"), /\(Picture\)/);
  assert.equal(it.reported.length, 1);
  // the message was as expected
  assert.equal(it.store.refused, 0);
  assert.equal(it.find(".refused").hidden, true);
});

test("stop and state are made first, and told before the others", async () => {
  const order = [];
  const noting = (name) => ({
    make(parent, store) {
      order.push(name);
      store.on("view", () => order.push(`${name} view`));
    },
  });
  const it = framed(Object.fromEntries(["picture", "motion", "status", "stop", "verdict"].map((name) => [name, noting(name)])));
  assert.deepEqual(order.slice(0, 2), ["stop", "status"]);
  await it.hear("kr120", "view", view());
  assert.deepEqual(order.slice(5, 7), ["stop view", "status view"]);
  assert.equal(order.length, 10);
  // in the document they stay where they are looked for
  assert.deepEqual([...it.document.querySelectorAll(".area")].slice(0, 3).map(({id}) => id), ["status", "picture", "stop"]);
});

test("without its stop the page says so, and what to use", () => {
  const it = framed({stop: broken, status: real(status)});
  assert.match(it.text(".failed"), /THE STOP OF THIS PAGE HAS FAILED.*emergency stop/);
});

test("a verdict panel that has failed takes no presses, and lets go of the one that is held", async () => {
  const held = {at: 0, timers: []};
  const other = {
    make(parent, store) {
      store.on("screen", () => {
        throw new RangeError("no text");
      });
    },
  };
  const it = framed({verdict: [real(playback, held), real(verdict, held), other], stop: real(stop)});
  const pass = async (ms) => {
    for (const end = held.at + ms; held.at < end;) {
      held.at += 50;
      await it.hear("kr120", "view", view({plan: "p1"}));
      for (const call of held.timers) call();
    }
  };
  await it.hear("kr120", "view", view({plan: "p1"}));
  await it.hear("kr120", "plan", plan(), true);
  it.store.set("looked", "kr120", {what: "checks", hash: "h1"});
  await pass(1500);
  it.find(".verdict-approve").dispatchEvent(new it.window.Event("pointerdown"));
  await pass(500);
  assert.equal(it.text(".verdict-approve-text"), "Keep holding ...");
  await it.hear("kr120", "screen", []);
  assert.equal(it.find("#verdict").hasAttribute("inert"), true);
  assert.match(it.text(".failed"), /\(Plan under review\)/);
  await pass(1500);
  assert.deepEqual(it.connection.sent, []);
  assert.match(it.text(".verdict-notice"), /Not approved/);
});
