/** Calls: for what, when they ring, what stops them, and what a device does. */
import assert from "node:assert/strict";
import {test} from "node:test";
import * as calls from "../src/calls/calls.js";
import {makeSound, TONES} from "../src/calls/sound.js";
import * as state from "../src/calls/state.js";
import {fakePage, plan, view, work} from "./support/fake.js";

const CAUSE = {topic: "cause", words: "cause.held", level: 2, sentence: "The arm holds."};
const message = (id, changes = {}) => ({id, at: 1, line: {topic: "link", level: 2, sentence: "x", ...changes}, acknowledged_by: ""});

/** A record of the store. */
function record(changes = {}) {
  return {name: "one", old: false, plan: null, screen: [], tasks: null, heard: {screen: 0}, ...changes};
}

/** Look again and again, every 250 ms from `from` on; return what has rung, as [ms, kind]. */
function follow(begin, robot, from, until) {
  let now = begin;
  const rings = [];
  for (let at = from; at <= until; at += 250) {
    now = state.renewed(now, [{...robot, heard: {screen: at}}], at);
    const found = state.rung(now, at);
    now = found.state;
    if (found.kind) rings.push([at, found.kind]);
  }
  return {now, rings};
}

test("it calls for a plan, a cause, a question and a new message, the most urgent first", () => {
  const tasks = {tasks: [{id: "7", state: "asks", question: "Is it in the grip?"}, {id: "8", state: "held"}]};
  const quiet = state.renewed(state.begin(), [record({messages: [message("old")]})], 0);
  assert.deepEqual(quiet.calls, []);
  const messages = [message("old"), message("new"), message("read", {}), message("of course", {level: 0}), message("cause", {topic: "cause"})];
  messages[2].acknowledged_by = "ada";
  const {calls: found} = state.renewed(quiet, [record({plan: plan(), screen: [CAUSE], tasks, messages})], 0);
  assert.deepEqual(state.present({calls: found}).map(({kind, robot}) => [kind, robot]), state.KINDS.map((kind) => [kind, "one"]));
});

test("what is not the present calls for nothing", () => {
  for (const robot of [record({plan: plan(), old: true}), record({screen: [CAUSE], heard: {screen: -4000}})]) {
    assert.deepEqual(state.present(state.renewed(state.begin(), [robot], 0)), []);
  }
});

test("it rings at once, then ever more rarely, and after seven times no more", () => {
  const {rings} = follow(state.begin(), record({plan: plan()}), 0, 1200000);
  assert.deepEqual(rings, state.RINGS.map((at) => [at, "plan"]));
  assert.equal(rings.length, 7);
  for (let k = 2; k < rings.length; k += 1) assert.ok(rings[k][0] - rings[k - 1][0] > rings[k - 1][0] - rings[k - 2][0]);
});

test("of several calls at once the most urgent one rings, and a page that stood still makes up for nothing", () => {
  const robot = record({plan: plan(), screen: [CAUSE]});
  assert.deepEqual(follow(state.begin(), robot, 0, 14000).rings, [[0, "hold"]]);
  const first = state.rung(state.renewed(state.begin(), [robot], 0), 0).state;
  const later = state.rung(first, 300000);
  assert.equal(later.kind, "hold");
  assert.equal(state.rung(later.state, 300250).kind, "");
});

test("who has looked is called no more for it, and for the next thing again", () => {
  let {now} = follow(state.begin(), record({plan: plan()}), 0, 1000);
  now = state.looked(now);
  const quiet = follow(now, record({plan: plan()}), 1250, 600000);
  assert.deepEqual(quiet.rings, []);
  // it waits still
  assert.equal(state.present(quiet.now).length, 1);
  assert.deepEqual(follow(quiet.now, record({plan: plan({id: "p2"})}), 600250, 600500).rings, [[600250, "plan"]]);
});

test("a connection that was lost for a moment does not call again for what was looked at, and a cause that comes back does", () => {
  const robot = record({plan: plan(), screen: [CAUSE]});
  let now = state.looked(follow(state.begin(), robot, 0, 1000).now);
  const lost = follow(now, {...robot, old: true, plan: null, screen: null}, 1250, 60000);
  assert.deepEqual(state.present(lost.now), []);
  now = follow(lost.now, record({plan: plan(), screen: [CAUSE]}), 60250, 70000);
  assert.deepEqual(now.rings, []);
  assert.equal(state.present(now.now).length, 2);
  const over = follow(now.now, record({plan: plan()}), 70250, 80000);
  assert.deepEqual(follow(over.now, record({plan: plan(), screen: [CAUSE]}), 80250, 81000).rings, [[80250, "hold"]]);
});

test("what the person has just done here is no call, but waits; later it is one, and another robot's is one", () => {
  const asked = state.acted(state.begin(), "one", "plan_request", 0);
  const own = follow(asked, record({plan: plan()}), 2000, 100000);
  assert.deepEqual(own.rings, []);
  assert.equal(state.present(own.now).length, 1);
  assert.equal(follow(asked, record({plan: plan()}), 20000, 21000).rings.length, 1);
  assert.equal(follow(asked, record({name: "two", plan: plan()}), 2000, 3000).rings.length, 1);
  const stopped = state.acted(state.begin(), "one", "stop", 0);
  assert.deepEqual(follow(stopped, record({screen: [CAUSE], plan: plan()}), 500, 1000).rings, [[500, "plan"]]);
  // a pose that is dragged has no consequence
  assert.deepEqual(state.acted(stopped, "one", "ik", 1), stopped);
});

test("each kind has a sound of its own that is neither shrill nor long", () => {
  assert.deepEqual(Object.keys(TONES).sort(), [...state.KINDS].sort());
  assert.equal(new Set(Object.values(TONES).map((tones) => JSON.stringify(tones.map(([pitch]) => pitch)))).size, 4);
  for (const tones of Object.values(TONES)) {
    for (const [pitch, begin, length] of tones) assert.ok(pitch >= 400 && pitch <= 900 && begin + length < 1.5);
  }
});

/** An AudioContext that waits for a touch, and notes the pitches that it was given. */
function fakeAudio({running = false} = {}) {
  const pitches = [];
  const parameter = () => ({setValueAtTime() {}, linearRampToValueAtTime() {}, exponentialRampToValueAtTime() {}});
  class Audio {
    state = running ? "running" : "suspended";
    currentTime = 0;
    destination = {};
    async resume() {
      this.state = "running";
    }
    createOscillator() {
      return {frequency: {set value(pitch) { pitches.push(pitch); }}, connect: (next) => next, start() {}, stop() {}};
    }
    createGain() {
      return {gain: parameter(), connect: (next) => next};
    }
  }
  return {Audio, pitches};
}

test("a sound waits for the first touch", async () => {
  const {Audio, pitches} = fakeAudio();
  const sound = makeSound(Audio, () => {});
  sound.open();
  assert.equal(sound.state, "locked");
  sound.play("plan");
  assert.deepEqual(pitches, []);
  await sound.unlock();
  assert.equal(sound.state, "ready");
  sound.play("plan");
  assert.deepEqual(pitches, TONES.plan.map(([pitch]) => pitch));
  assert.equal(makeSound(undefined, () => {}).state, "none");
});

test("the screen is kept on while it is wanted, and anew after the page was hidden", async () => {
  const locks = [];
  let visible = true;
  const awake = calls.makeAwake({request: async () => {
    locks.push({released: false, async release() { this.released = true; }});
    return locks.at(-1);
  }}, () => visible);
  awake(true);
  await awake(true);
  assert.deepEqual(locks.map(({released}) => released), [false]);
  // the browser takes it back
  locks[0].released = true;
  visible = false;
  await awake(true);
  assert.equal(locks.length, 1);
  visible = true;
  await awake(true);
  assert.deepEqual(locks.map(({released}) => released), [true, false]);
  await awake(false);
  // one that comes when it is no longer wanted
  awake(true);
  await awake(false);
  assert.ok(locks.every(({released}) => released));
  await calls.makeAwake(undefined, () => true)(true);
});

test("a wake lock that is refused fails nothing, and is asked for again", async () => {
  let asked = 0;
  const awake = calls.makeAwake({request: async () => { asked += 1; throw new Error("battery"); }}, () => true);
  await awake(true);
  await awake(true);
  assert.equal(asked, 2);
});

/** The page's calls, on a device that vibrates and has a badge; `held.at` [ms] is its clock, `pass` lets time go by. */
function calling({language = "en", stored = null, audio = fakeAudio({running: true})} = {}) {
  const page = fakePage({account: "ada", language});
  const {document} = page;
  const header = document.createElement("header");
  document.querySelector("main").before(header);
  header.className = "header";
  const icon = document.createElement("link");
  icon.setAttribute("rel", "icon");
  icon.setAttribute("href", "icon.svg");
  document.head.append(icon);
  const did = {badges: [], beats: []};
  const navigator = {
    vibrate: (beats) => did.beats.push(beats) > 0, setAppBadge: async (count) => did.badges.push(count), clearAppBadge: async () => did.badges.push(0),
  };
  const kept = new Map(stored ? [["construction_twin.calls", stored]] : []);
  const storage = {getItem: (key) => kept.get(key) ?? null, setItem: (key, value) => kept.set(key, value)};
  const timers = [];
  calls.make(header, page.store, page.connection, page.texts, {
    now: () => page.clock.now, every: (_, call) => timers.push(call), Audio: audio.Audio, navigator, storage,
  });
  const find = (selector) => document.querySelector(selector);
  const touch = () => document.body.dispatchEvent(new page.window.Event("pointerdown", {bubbles: true}));
  const pass = async (ms) => {
    for (const end = page.clock.now + ms; page.clock.now < end;) {
      page.clock.now += 250;
      await page.hear("kr120", "view", view());
      for (const call of timers) call();
    }
  };
  return {...page, did, kept, find, touch, pass, pitches: audio.pitches, icon};
}

test("a plan that comes is told by title, badge, icon, sound and vibration, until it is decided", async () => {
  const it = calling();
  await it.hear("kr120", "view", view());
  assert.equal(it.document.title, "construction_twin console");
  await it.hear("kr120", "plan", plan(), true);
  assert.equal(it.document.title, "(1) Plan waits - construction_twin console");
  assert.equal(it.icon.getAttribute("href"), "icon_call.svg");
  assert.equal(it.did.badges.at(-1), 1);
  assert.deepEqual(it.pitches, TONES.plan.map(([pitch]) => pitch));
  assert.equal(it.did.beats.length, 1);
  await it.pass(16000);
  assert.equal(it.did.beats.length, 2);
  it.touch();
  await it.pass(60000);
  assert.equal(it.did.beats.length, 2);
  await it.hear("kr120", "screen", [CAUSE]);
  assert.equal(it.document.title, "(2) Arm holds - construction_twin console");
  await it.hear("kr120", "plan", null, true);
  await it.hear("kr120", "screen", []);
  assert.equal(it.document.title, "construction_twin console");
  assert.equal(it.icon.getAttribute("href"), "icon.svg");
  assert.deepEqual(it.did.badges.slice(-4), [1, 2, 1, 0]);
});

test("a question of the work calls in the page's language", async () => {
  const it = calling({language: "de"});
  await it.hear("kr120", "view", view());
  const {tasks: [task]} = work();
  await it.hear("kr120", "work/tasks", work({tasks: [{...task, state: "asks", question: "Is it in the grip?"}]}), true);
  assert.equal(it.document.title, "(1) Frage offen - construction_twin-Konsole");
  it.connection.change("lost", "closed");
  assert.equal(it.document.title, "Nicht verbunden - construction_twin-Konsole");
});

test("off: title and icon alone; the choice outlasts the page, and who turns it on hears what it sounds like", async () => {
  const it = calling({stored: "off"});
  await it.hear("kr120", "view", view());
  await it.hear("kr120", "plan", plan(), true);
  assert.match(it.document.title, /Plan waits/);
  assert.deepEqual([it.pitches, it.did.beats], [[], []]);
  assert.equal(it.find(".calls-open").textContent, "Calls off");
  it.click(it.find(".calls-open"));
  await it.pass(250);
  assert.equal(it.kept.get("construction_twin.calls"), "on");
  assert.equal(it.find(".calls-open").textContent, "Calls on");
  assert.deepEqual(it.pitches, TONES.plan.map(([pitch]) => pitch));
  it.click(it.find(".calls-open"));
  assert.equal(it.kept.get("construction_twin.calls"), "off");
});

test("a sound that waits for a touch is said, and the touch unlocks it", async () => {
  const it = calling({audio: fakeAudio()});
  assert.match(it.find(".calls-line").textContent, /touch the page once/);
  await it.hear("kr120", "view", view());
  await it.hear("kr120", "plan", plan(), true);
  assert.deepEqual(it.pitches, []);
  it.touch();
  await it.pass(2000);
  assert.equal(it.find(".calls-line").textContent, "");
  await it.hear("kr120", "screen", [CAUSE]);
  assert.deepEqual(it.pitches, TONES.hold.map(([pitch]) => pitch));
});

test("the plan that this page has asked for does not ring", async () => {
  const it = calling();
  await it.hear("kr120", "view", view());
  it.store.set("acted", "kr120", {topic: "plan_request"});
  await it.hear("kr120", "plan", plan(), true);
  assert.match(it.document.title, /Plan waits/);
  assert.deepEqual([it.pitches, it.did.beats], [[], []]);
});
