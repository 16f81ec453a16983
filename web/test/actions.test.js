/** What a person can do about the state: reset and arm, held; the list of rights; the messages. */
import assert from "node:assert/strict";
import {test} from "node:test";
import * as actions from "../src/panels/actions.js";
import * as messages from "../src/panels/messages.js";
import {makeRights, readRights} from "../src/rights.js";
import {fakePage, view} from "./support/fake.js";

const settle = () => new Promise((done) => setTimeout(done));
const STOPPED = {...view().link, state: "NEEDS_RESET", reason: "gateway was stopped (stop 3) and is stopped: asked by account bob"};

/** A page with the panel, its robot stopped, and a clock: `pass(ms)`. */
async function panel(account = "ada", may = () => true, kind = "rsi") {
  const clock = {at: 0, looks: [], now: () => clock.at, every: (_, look) => clock.looks.push(look)};
  const page = fakePage({account});
  page.store.rightsOf = {may, who: () => ["ada", "cora"]};
  actions.make(page.parent, page.store, page.connection, page.texts, clock);
  await page.hear("kr120", "view", view({link: {...STOPPED, gateway_kind: kind}}));
  page.find = (selector) => page.parent.querySelector(selector);
  page.fire = (element, kind, more = {}) => element.dispatchEvent(Object.assign(new page.window.Event(kind, {bubbles: true}), more));
  page.pass = async (ms) => {
    for (let k = 0; k < ms / 50; k += 1) {
      clock.at += 50;
      for (const look of clock.looks) look();
    }
    await settle();
  };
  return page;
}

test("nothing is offered where nothing waits for it", async () => {
  const page = await panel();
  assert.equal(page.find(".actions").hidden, false);
  await page.hear("kr120", "view", view());
  assert.equal(page.find(".actions").hidden, true);
});

test("a gate that was closed for good under an armed link is reset here, and a press is void when it is another matter", async () => {
  const page = await panel();
  const gate = (state) => view({sync: {...view().sync, state, reason: "held for 30 s; call reset"}, link: {...view().link, state: "ARMED"}});
  await page.hear("kr120", "view", gate("HOLDING"));
  assert.equal(page.find(".actions").hidden, true, "it goes on by itself");
  await page.hear("kr120", "view", gate("STOPPED"));
  assert.deepEqual(["reset", "arm"].map((verb) => page.find(`.action-${verb}`).hidden), [false, true]);
  page.fire(page.find(".action-reset"), "pointerdown", {button: 0});
  await page.pass(600);
  await page.hear("kr120", "view", view({sync: gate("STOPPED").sync, link: STOPPED}));
  await page.pass(2000);
  assert.deepEqual(page.connection.sent, []);
  await page.hear("kr120", "view", gate("STOPPED"));
  page.fire(page.find(".action-reset"), "pointerdown", {button: 0});
  await page.pass(1100);
  assert.deepEqual(page.connection.sent.map(({topic}) => topic), ["reset/ada"]);
});

for (const [kind, verb] of [["rsi", "reset"], ["plc", "arm"]]) {
  test(`${verb} goes out when it was held for a second, with what the page had shown`, async () => {
    const page = await panel("ada", () => true, kind);
    assert.deepEqual(["reset", "arm"].filter((each) => !page.find(`.action-${each}`).hidden), [verb], "a stop is lifted by a reset alone");
    const button = page.find(`.action-${verb}`);
    page.fire(button, "pointerdown", {button: 0});
    await page.pass(900);
    assert.deepEqual(page.connection.sent, []);
    await page.pass(200);
    const {topic, robot, payload} = page.connection.sent[0];
    assert.deepEqual([topic, robot], [`${verb}/ada`, "kr120"]);
    assert.deepEqual(payload, {id: payload.id, moment: page.store.moment("kr120")});
    assert.equal(button.disabled, true, "not twice");
    const answer = {id: payload.id, account: "ada", ok: false, reason: "cannot reset: the arm moves", by: "bridge", expired: false};
    await page.hear("kr120", `${verb}/ack`, answer);
    assert.match(page.find(".actions-result").textContent, /was NOT carried out: cannot reset: the arm moves/);
    assert.equal(button.disabled, false);
  });
}

test("another stop while it is held ends the press", async () => {
  const page = await panel();
  page.fire(page.find(".action-reset"), "pointerdown", {button: 0});
  await page.pass(600);
  await page.hear("kr120", "view", view({link: {...STOPPED, reason: "gateway was stopped (stop 4) and is stopped: asked by account sam"}}));
  await page.pass(2000);
  assert.deepEqual(page.connection.sent, []);
});

test("a page that stood still sends nothing", async () => {
  const page = await panel();
  page.fire(page.find(".action-reset"), "pointerdown", {button: 0});
  await page.pass(500);
  page.parent.ownerDocument.dispatchEvent(new page.window.Event("visibilitychange"));
  await page.pass(2000);
  assert.deepEqual(page.connection.sent, []);
});

test("an answer that is long in coming is no answer after fifteen seconds", async () => {
  const page = await panel();
  page.fire(page.find(".action-reset"), "pointerdown", {button: 0});
  await page.pass(1100);
  assert.match(page.find(".actions-result").textContent, /no answer yet/);
  await page.pass(14000);
  assert.match(page.find(".actions-result").textContent, /no answer yet/);
  await page.pass(2000);
  assert.match(page.find(".actions-result").textContent, /NO ANSWER/);
});

test("who may not is told who can", async () => {
  const page = await panel("vic", () => false);
  assert.equal(page.find(".action-reset").hidden, true);
  assert.match(page.find(".actions-who").textContent, /ada, cora/);
});

// -- rights

test("a list is what it should be, or none", () => {
  assert.deepEqual(readRights({robots: {one: {ada: ["look"]}}}).one.ada, ["look"]);
  for (const wrong of [null, [], {}, {robots: []}, {robots: {one: 1}}, {robots: {one: ["ada"]}}, {robots: {one: {ada: "look"}}}]) {
    assert.equal(readRights(wrong), null);
  }
});

test("rights are those of the account by the list, and unknown without one", async () => {
  const page = fakePage({account: "ada"});
  let answer = {ok: true, json: async () => ({robots: {kr120: {ada: ["look", "operate"], bob: ["look", "reset"], vic: ["look"]}}})};
  const told = [];
  page.store.on("rights", (_, list) => told.push(list !== null));
  const rights = makeRights(page.store, page.connection, async () => answer);
  assert.equal(rights.may("kr120", "stop"), null);
  page.connection.change("connected");
  await settle();
  assert.deepEqual([rights.may("kr120", "stop"), rights.may("kr120", "reset"), rights.may("kr6", "stop")], [true, false, null]);
  assert.deepEqual(rights.who("kr120", "stop"), ["bob"]);
  answer = {ok: false, json: async () => null};
  page.connection.change("connected");
  await settle();
  assert.equal(rights.may("kr120", "stop"), null);
  assert.deepEqual(told, [true, false]);
});

// -- messages

const LINE = {topic: "link", state: "NEEDS_RESET", level: 2, sentence: "The arm was stopped, and holds.",
  waits_for: "", who: "", todo: "", page: ""};
const MESSAGE = {id: "m1", at: 1000, line: LINE, until: null, acknowledged_by: "", acknowledged_at: null};

async function history(list, may = () => true) {
  const page = fakePage({account: "ada"});
  page.store.rightsOf = {may, who: () => []};
  const marks = [];
  page.parent.tab = {mark: (text) => marks.push(text)};
  messages.make(page.parent, page.store, page.connection, page.texts, {when: (at) => (at === null ? "" : `at ${at}`)});
  await page.hear("kr120", "view", view());
  await page.hear("kr120", "messages", list, true);
  return {...page, marks, items: () => [...page.parent.querySelectorAll(".message")]};
}

test("messages stand newest first, and those that nobody has read are counted", async () => {
  const read = {...MESSAGE, id: "m0", at: 10, until: 20, acknowledged_by: "bob", acknowledged_at: 30};
  const act = {...MESSAGE, id: "m2", at: 2000, until: 2000, line: {...LINE, topic: "person", state: "reset", sentence: "ada asked for a reset. It lifts: stop 3"}};
  const page = await history([read, MESSAGE, act]);
  const texts = page.items().map((each) => each.textContent);
  assert.match(texts[0], /ada asked for a reset\. It lifts: stop 3/);
  assert.match(texts[1], /since at 1000.*The arm was stopped/);
  assert.match(texts[2], /at 10, until at 20.*Acknowledged by bob, at 30/);
  assert.equal(page.marks.at(-1), "1");
  assert.deepEqual(page.items().map((each) => each.querySelector("button") !== null), [false, true, false]);
});

test("one is acknowledged in the name of the account, and what became of it is told", async () => {
  const page = await history([MESSAGE]);
  page.click(page.parent.querySelector(".message-acknowledge"));
  await settle();
  const {topic, payload} = page.connection.sent[0];
  assert.deepEqual([topic, payload.message], ["acknowledge/ada", "m1"]);
  await page.hear("kr120", "acknowledge/ack", {id: payload.id, account: "ada", message: "m1", ok: false, reason: "bob has acknowledged it already"});
  assert.match(page.parent.querySelector(".messages-told").textContent, /bob has acknowledged/);
  await page.hear("kr120", "messages", [{...MESSAGE, acknowledged_by: "bob", acknowledged_at: 5}], true);
  assert.equal(page.parent.querySelector(".message-acknowledge"), null);
  assert.equal(page.marks.at(-1), "");
});

test("who may not acknowledge has no button", async () => {
  const page = await history([MESSAGE], () => false);
  assert.equal(page.parent.querySelector(".message-acknowledge"), null);
});
