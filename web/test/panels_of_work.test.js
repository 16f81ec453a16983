/** The panels plan and tasks, in a document without a browser. */
import assert from "node:assert/strict";
import {readFileSync} from "node:fs";
import {test} from "node:test";
import * as plan from "../src/panels/plan.js";
import * as tasks from "../src/panels/tasks.js";
import {readModels} from "../src/planning/model.js";
import {counts, group, isAskable, nextTask, stateOfElement, taskOfElement, waitsFor} from "../src/work/task_list.js";
import {fakePage, view} from "./support/fake.js";
import {textsIn} from "./support/sentences.js";

const URDF = readFileSync(new URL("support/track.urdf", import.meta.url), "utf8");
const NAMES = ["track", "joint_a1", "joint_a2", "joint_a3", "joint_a4", "joint_a5", "joint_a6"];
const POSITIONS = [0.2, 0, -1.5, 1.5, 0, 1.2, 0];
const settle = () => new Promise((resolve) => setImmediate(resolve));

function trackView(changes = {}) {
  const pose = {stamp: 1, age: 0, positions: POSITIONS};
  return view({joints: {names: NAMES, types: ["prismatic", ...Array(6).fill("revolute")]}, twin: pose, arm: pose, ...changes});
}

/** A plan panel of a robot whose model is there; `page.time` is its clock [s]; with `keeps` false it has the browser's own storage;
 * without `rights` nothing is known of them. */
async function planPanel({account = "kr120-planner-ada", refuse = null, rights = null, fetchText = async () => URDF, keeps = true} = {}) {
  const page = fakePage({account});
  if (rights !== null) page.store.rightsOf = rights;
  page.time = 100;
  const kept = new Map();
  const storage = {getItem: (key) => kept.get(key) ?? null, setItem: (key, value) => void kept.set(key, value)};
  if (refuse !== null) page.connection.refuse(refuse);
  plan.make(page.parent, page.store, page.connection, page.texts, {now: () => page.time, ...(keeps ? {storage} : {})});
  readModels(page.store, page.connection, fetchText);
  await page.hear("kr120", "view", trackView());
  await settle();
  await page.hear("kr120", "view", trackView());
  await settle();
  page.find = (selector) => page.parent.querySelector(selector);
  page.text = (selector) => page.find(selector).textContent;
  page.buttonOf = (key) => [...page.parent.querySelectorAll("button")].find((one) => one.textContent === page.texts(key));
  page.press = (key) => page.click(page.buttonOf(key));
  page.goal = () => page.store.robot("kr120").goal;
  return page;
}

// -- plan

/** Rights as the list of the site says: who may plan here, by account. */
const listed = (people) => ({
  may: (_, right) => (right === "operate" ? Object.hasOwn(people, "kr120-planner-ada") : null),
  who: (_, right) => (right === "operate" ? Object.entries(people).filter(([account]) => account !== "kr120-planner-ada").map(([, name]) => name) : []),
});

test("nothing is tried to find out a right; a person sets a goal where the robot is", async () => {
  for (const rights of [null, listed({"kr120-planner-ada": "ada"})]) {
    const page = await planPanel({rights});
    assert.deepEqual(page.connection.sent, []);
    assert.equal(page.text(".plan-told"), "");
    assert.equal(page.find(".plan-work").hidden, true);
    page.press("Set a goal");
    assert.equal(page.find(".plan-work").hidden, false);
    assert.deepEqual(page.goal().names, NAMES);
    assert.deepEqual(page.goal().positions, POSITIONS);
    assert.equal(page.parent.querySelectorAll(".plan-joint").length, 7);
    assert.deepEqual(page.connection.sent, []);
  }
});

test("an account that may not plan reads who can, and gets no sliders", async () => {
  const page = await planPanel({rights: listed({pia: "pia"})});
  assert.equal(page.find(".plan-work").hidden, true);
  assert.equal(page.find(".plan-begin").hidden, true);
  assert.equal(page.text(".plan-told"), "This account may not ask for plans. Who can: pia.");
  page.store.rightsOf = listed({});
  page.store.rights({});
  assert.equal(page.text(".plan-told"), "This account may not ask for plans. Nobody is listed who can; at the robot's computer it can be done.");
  page.store.rightsOf = listed({"kr120-planner-ada": "ada"});
  page.store.rights({});
  assert.equal(page.find(".plan-begin").hidden, false);
  assert.deepEqual(page.connection.sent, []);
});

test("where no list says it, the broker's refusal of what a person asks for is told, until the next connection", async () => {
  const page = await planPanel({account: "kr120-viewer", refuse: "refused"});
  page.press("Set a goal");
  page.press("Ask for this plan");
  await settle();
  assert.equal(page.find(".plan-work").hidden, true);
  assert.equal(page.find(".plan-begin").hidden, true);
  assert.match(page.text(".plan-told"), /kr120-viewer may look, and may not ask for plans/);
  page.connection.change("lost", "closed");
  assert.match(page.text(".plan-told"), /Not connected/);
  page.connection.refuse(null);
  page.connection.change("connected");
  assert.equal(page.find(".plan-work").hidden, false);
  assert.equal(page.connection.sent.length, 1);
});

test("a list that says more than the broker is not believed, and names who else can", async () => {
  const page = await planPanel({rights: listed({"kr120-planner-ada": "ada", pia: "pia"}), refuse: "refused"});
  page.press("Set a goal");
  page.press("Ask for this plan");
  await settle();
  assert.equal(page.text(".plan-told"), "This account may not ask for plans. Who can: pia.");
});

test("a goal can be set as soon as the robot says its pose", async () => {
  const page = await planPanel();
  await page.hear("kr120", "view", trackView({twin: null, arm: null}));
  assert.equal(page.find(".plan-begin").disabled, true);
  assert.equal(page.text(".plan-told"), page.texts("Where the robot is, is not known, so no goal can be set."));
  await page.hear("kr120", "view", trackView());
  assert.equal(page.find(".plan-begin").disabled, false);
  assert.equal(page.text(".plan-told"), "");
});

test("a model that cannot be read is told with the reason", async () => {
  const page = await planPanel({
    fetchText: async () => {
      throw new Error("404");
    },
  });
  assert.match(page.text(".plan-told"), /could not be loaded \(404\)/);
  assert.equal(page.find(".plan-begin").hidden, true);
  assert.equal((await planPanel({fetchText: async () => "<robot></robot>"})).text(".plan-told").includes("no joint track"), true);
});

test("a slider sets the joint in degrees, and the tool's numbers follow", async () => {
  const page = await planPanel();
  page.press("Set a goal");
  const x = () => page.find(".plan-tool-fields input").value;
  const before = x();
  const slider = page.parent.querySelectorAll(".plan-joint input[type=range]")[1];
  page.enter(slider, "30");
  assert.ok(Math.abs(page.goal().positions[1] - Math.PI / 6) < 1e-9);
  assert.notEqual(x(), before);
  assert.equal(page.goal().positions[2], POSITIONS[2]);
});

test("a number that is typed outside of the range is not taken, and said", async () => {
  const page = await planPanel();
  page.press("Set a goal");
  const field = page.parent.querySelectorAll(".plan-joint input[type=text]")[1];
  page.enter(field, "200");
  assert.equal(page.goal().positions[1], POSITIONS[1]);
  assert.match(page.text(".plan-wrong"), /joint_a1 goes from -185 to 185/);
  page.enter(field, "-45,5");
  assert.ok(Math.abs(page.goal().positions[1] + 45.5 * (Math.PI / 180)) < 1e-9);
});

test("the plan that is asked for is the one that is shown, and the planner's answer is told", async () => {
  const page = await planPanel();
  page.press("Set a goal");
  const options = [...page.parent.querySelectorAll("option")];
  assert.deepEqual(options.map((option) => option.value), ["0", "0.1", "0.25", "0.5", "1"]);
  page.press("Ask for this plan");
  await settle();
  const {topic, payload, qos} = page.connection.sent.at(-1);
  assert.deepEqual([topic, qos, payload.kind], ["plan_request/kr120-planner-ada", 1, "joints"]);
  assert.deepEqual(NAMES.map((name) => payload.joints[name]), page.goal().positions);
  assert.match(page.text(".plan-answer"), /Sent\. The planner is looking/);
  assert.equal(page.buttonOf("Ask for this plan").disabled, true);
  const ack = {account: "kr120-planner-ada", kind: "joints", plan_id: "", plan_hash: "", duration: 0};
  await page.hear("kr120", "plan_request/ack", {...ack, id: "another", ok: true, reason: ""});
  assert.match(page.text(".plan-answer"), /looking/);
  await page.hear("kr120", "plan_request/ack", {...ack, id: payload.id, ok: false, reason: "the floor is in the way"});
  assert.equal(page.text(".plan-answer"), "No plan: the floor is in the way");
  assert.equal(page.buttonOf("Ask for this plan").disabled, false);
  page.enter(page.find(".plan-tool-fields input"), "1234,5");
  page.press("Ask for a straight line of the tool to there");
  await settle();
  const line = page.connection.sent.at(-1).payload;
  assert.deepEqual([line.kind, line.position[0], line.orientation.length, line.joints], ["line", 1.2345, 4, undefined]);
  await page.hear("kr120", "plan_request/ack", {...ack, id: line.id, ok: true, reason: "", duration: 3.25});
  assert.match(page.text(".plan-answer"), /There is a plan \(3\.3 s\)/);
});

test("a request whose answer was lost with the connection is told as such, and none is sent twice", async () => {
  const page = await planPanel();
  page.press("Set a goal");
  page.press("Ask for this plan");
  await settle();
  const sent = page.connection.sent.length;
  page.connection.change("lost", "closed");
  assert.equal(page.buttonOf("Ask for this plan").disabled, true);
  page.connection.change("connected");
  await page.hear("kr120", "view", trackView());
  await settle();
  assert.match(page.text(".plan-answer"), /may have arrived/);
  assert.equal(page.connection.sent.length, sent);
});

test("saved poses come back, and a name is needed", async () => {
  const page = await planPanel();
  page.press("Set a goal");
  page.press("Save the goal");
  assert.match(page.text(".plan-note"), /Give the pose a name first/);
  const name = page.find(".plan-poses input");
  name.value = "<b>home</b>";
  page.press("Save the goal");
  assert.equal(page.find(".plan-poses option").textContent, "<b>home</b>");
  page.enter(page.parent.querySelectorAll(".plan-joint input[type=range]")[2], "-60");
  assert.notDeepEqual(page.goal().positions, POSITIONS);
  page.find(".plan-poses option").setAttribute("selected", "");
  page.press("Take this pose as goal");
  assert.deepEqual(page.goal().positions, POSITIONS);
});

test("a discarded goal is gone from the picture, too", async () => {
  const page = await planPanel();
  page.press("Set a goal");
  page.press("Discard the goal");
  assert.equal(page.goal(), null);
  assert.equal(page.find(".plan-begin").hidden, false);
});

test("a browser that forbids pages to keep anything has the panel all the same, and says that a pose was not saved", async (t) => {
  const before = Object.getOwnPropertyDescriptor(globalThis, "localStorage");
  t.after(() => (before ? Object.defineProperty(globalThis, "localStorage", before) : delete globalThis.localStorage));
  Object.defineProperty(globalThis, "localStorage", {
    configurable: true,
    get() {
      throw new DOMException("access is denied", "SecurityError");
    },
  });
  const page = await planPanel({keeps: false});
  page.press("Set a goal");
  page.enter(page.find(".plan-poses input"), "above");
  page.press("Save the goal");
  assert.equal(page.text(".plan-note"), page.texts("This browser keeps nothing for pages, so the pose was not saved."));
});

// -- tasks

const task = (id, state, more = {}) => ({
  id, name: `Place ${id}`, element: `e_${id}`, element_name: `stud ${id}`, state, reason: "", after: [], robot: "", plan_id: "",
  deviation_mm: null, deviation_deg: null, question: "", answers: [], ...more,
});
const work = (changes = {}) => ({
  stamp: 1, model: "panel.ifc", model_hash: "h", schedule: "model", engaged: false, next: "2", reason: "", notes: [],
  tasks: [
    task("1", "done", {deviation_mm: 0.42, deviation_deg: 0.05}), task("2", "ready"),
    task("3", "waiting", {after: ["1", "2"], reason: "waits for Place 2"}),
    task("4", "asks", {question: "Where is stud 4?", answers: ["in_stock", "placed"]}),
  ],
  ...changes,
});

async function tasksPanel(value = work(), account = "kr120-planner-ada", language = "en", clock = {now: () => 0, every: () => {}}) {
  const page = fakePage({account, language});
  tasks.make(page.parent, page.store, page.connection, page.texts, clock);
  await page.hear("kr120", "view", view());
  if (value !== null) await page.hear("kr120", "work/tasks", value, true);
  page.find = (selector) => page.parent.querySelector(selector);
  page.items = () => [...page.parent.querySelectorAll(".tasks-list .task")];
  return page;
}

test("every state that the table of tasks has is in a group", () => {
  const states = readFileSync(new URL("../../src/construction_twin/extensions/work/task_memory.py", import.meta.url), "utf8");
  const table = states.slice(states.indexOf("class TaskState"), states.indexOf("class TaskEvent"));
  const words = [...table.matchAll(/= "(\w+)"/g)].map(([, word]) => word);
  assert.ok(words.length > 10);
  for (const word of words) assert.notEqual(group(word), "unknown", word);
  assert.equal(group("constructor"), "unknown");
});

test("done and skipped tasks are done with; a task waits for the others", () => {
  const all = work();
  assert.deepEqual(counts(all), {done: 1, all: 4});
  assert.equal(nextTask(all).id, "2");
  assert.equal(nextTask(work({next: ""})), null);
  assert.deepEqual(waitsFor(all, all.tasks[2]), ["Place 2"]);
  assert.equal(isAskable(all, all.tasks[1]), true);
  assert.equal(isAskable(all, all.tasks[2]), false);
  assert.equal(isAskable(work({engaged: true}), all.tasks[1]), false);
});

test("an element that is placed in two tasks leads to the one that is not over", () => {
  const both = work({tasks: [task("1", "done", {element: "x"}), task("2", "ready", {element: "x"})]});
  assert.equal(taskOfElement(both, "x").id, "2");
  assert.equal(taskOfElement(work({tasks: [task("1", "done", {element: "x"})]}), "x").id, "1");
  assert.equal(taskOfElement(both, "y"), null);
});

test("an element with several tasks has the colour of the one that is open, but what was placed stands", () => {
  const states = (...each) => stateOfElement(work({tasks: each.map((state, k) => task(`${k}`, state, {element: "x"}))}), "x");
  assert.equal(states("carrying", "waiting"), "carrying");
  assert.equal(states("waiting", "waiting"), "waiting");
  assert.equal(states("done", "waiting"), "done");
  assert.equal(states("done", "ready"), "ready");
  assert.equal(states("done", "skipped"), "done");
  assert.equal(states("skipped", "skipped"), "skipped");
  assert.equal(stateOfElement(work({tasks: []}), "x"), undefined);
});

test("a robot without a building model has no list of tasks", async () => {
  const page = await tasksPanel(null);
  assert.equal(page.find(".tasks").hidden, true);
  await page.hear("kr120", "work/tasks", work(), true);
  assert.equal(page.find(".tasks").hidden, false);
  await page.hear("kr120", "work/tasks", null);
  assert.equal(page.find(".tasks").hidden, true);
});

test("the list says state and progress, and the next task can be asked for", async () => {
  const page = await tasksPanel();
  assert.match(page.find(".tasks-progress").textContent, /1 of 4 done/);
  assert.deepEqual(page.items().map((item) => item.lastElementChild.textContent), ["done", "ready", "waits", "needs a person"]);
  page.click(page.find(".tasks-next .plan-ask"));
  await settle();
  const {topic, payload} = page.connection.sent[0];
  assert.equal(topic, "plan_request/kr120-planner-ada");
  assert.deepEqual(payload, {id: payload.id, moment: page.store.moment("kr120"), kind: "work_task"});
  assert.match(payload.moment, /^c0ffee00-/);
  assert.equal(page.find(".tasks-next .plan-ask").disabled, true);
  await page.hear("kr120", "plan_request/ack", {id: payload.id, account: "kr120-planner-ada", ok: true, reason: "", duration: 14.2});
  assert.match(page.find(".plan-answer").textContent, /14\.2 s/);
});

test("a request that was too late says that somebody must look again, and another can be asked", async () => {
  const page = await tasksPanel();
  page.click(page.find(".tasks-next .plan-ask"));
  await settle();
  const {payload} = page.connection.sent[0];
  await page.hear("kr120", "plan_request/ack", {id: payload.id, account: "kr120-planner-ada", ok: false, expired: true, reason: "the request is too old"});
  assert.match(page.find(".plan-answer").textContent, /too late after what this page had shown.*Look again/);
  assert.equal(page.find(".tasks-next .plan-ask").disabled, false);
});

test("a tap on an element selects its task, and the picture is told", async () => {
  const page = await tasksPanel();
  page.store.set("tap", "kr120", {element: "e_2", object: ""});
  assert.equal(page.items()[1].getAttribute("aria-pressed"), "true");
  assert.match(page.find(".tasks-detail").textContent, /stud 2/);
  page.click(page.find(".tasks-detail .plan-ask"));
  await settle();
  assert.equal(page.connection.sent[0].payload.task, "2");
  page.store.set("tap", "kr120", {element: "", object: "floor"});
  assert.equal(page.items()[1].getAttribute("aria-pressed"), "true");
  page.click(page.items()[2]);
  assert.match(page.find(".tasks-detail").textContent, /First these must be done: Place 2/);
  assert.equal(page.find(".tasks-detail .plan-ask"), null);
  page.click(page.items()[2]);
  assert.equal(page.find(".tasks-detail").hidden, true);
});

test("deviations and questions are shown", async () => {
  const page = await tasksPanel();
  page.click(page.items()[0]);
  assert.match(page.find(".tasks-detail").textContent, /0\.4 mm and 0\.05° off the model/);
  page.click(page.items()[3]);
  assert.match(page.find(".tasks-question").textContent, /Where is stud 4\?/);
  const answers = [...page.parent.querySelectorAll(".tasks-answer")].map((each) => each.textContent);
  assert.deepEqual(answers, ["it lies in its stock, and the grip is empty", "it stands at its place, and the grip is empty"]);
});

test("a question is answered by holding, in the name of the account, with the question as it was shown", async () => {
  const clock = {at: 0, looks: [], now: () => clock.at, every: (_, look) => clock.looks.push(look)};
  const pass = (ms) => {
    for (let k = 0; k < ms / 50; k += 1) {
      clock.at += 50;
      for (const look of clock.looks) look();
    }
  };
  const page = await tasksPanel(undefined, "ada", "en", clock);
  const held = page.parent.querySelectorAll(".tasks-answer")[1];
  const press = (kind) => held.dispatchEvent(Object.assign(new page.window.Event(kind, {bubbles: true}), {button: 0}));
  press("pointerdown");
  pass(500);
  press("pointerup");
  pass(2000);
  assert.deepEqual(page.connection.sent, [], "a touch alone says nothing");
  press("pointerdown");
  pass(1100);
  await settle();
  const {topic, payload} = page.connection.sent[0];
  const {id, question, answers} = page.store.robot("kr120").tasks.tasks[3];
  assert.equal(topic, "answer/ada");
  assert.deepEqual(payload, {id: payload.id, task: id, question, answer: answers[1], moment: page.store.moment("kr120")});
  await page.hear("kr120", "answer/ack", {id: payload.id, account: "ada", task: id, ok: false, reason: "look again", expired: true});
  assert.match(page.find(".tasks-answered").textContent, /does NOT count: .* look again/);
});

test("who may not answer reads who can", async () => {
  const page = await tasksPanel(undefined, "vic");
  page.store.rightsOf = {may: (_, right) => right !== "operate", who: () => ["ada"]};
  page.store.rights({});
  assert.equal(page.find(".tasks-answer"), null);
  assert.match(page.find(".tasks-answers").textContent, /may not answer\. Who can: ada/);
});

test("what a task waits for and what is asked of it is said in the page's language", async () => {
  // three sentences of the page's own stand for those of a robot
  const texts = textsIn("de");
  const sentences = [["Next: {task}", {task: "Place 2"}], ["Waits for: {what}", {what: "Place 2"}], ["Element: {element}", {element: "stud 4"}]];
  const [whole, reason, question] = sentences.map(([template, values]) => textsIn("en")(template, values));
  const said = Object.fromEntries(sentences.map(([template, values]) => [textsIn("en")(template, values), {template, values}]));
  const asked = work({reason: whole, tasks: [task("3", "waiting", {reason}), task("4", "asks", {question})], said});
  const german = sentences.map(([template, values]) => texts(template, values));
  for (const [language, expected] of [["en", [whole, reason, question]], ["de", german]]) {
    const page = await tasksPanel(asked, undefined, language);
    assert.equal(page.find(".tasks-reason").textContent, expected[0]);
    page.click(page.items()[0]);
    assert.ok(page.find(".tasks-detail").textContent.includes(expected[1]));
    page.click(page.items()[1]);
    assert.ok(page.find(".tasks-question").textContent.includes(expected[2]));
  }
});

test("an engaged arm is offered the way back only", async () => {
  const page = await tasksPanel(work({engaged: true}));
  const [next, back] = page.parent.querySelectorAll(".tasks-next .plan-ask");
  assert.deepEqual([next.hidden, back.hidden], [true, false]);
  page.click(back);
  await settle();
  assert.equal(page.connection.sent[0].payload.kind, "way_back");
});

test("a refused right is told with the account", async () => {
  const page = await tasksPanel(work(), "kr120-viewer");
  page.connection.refuse("refused");
  page.click(page.find(".tasks-next .plan-ask"));
  await settle();
  assert.match(page.find(".plan-answer").textContent, /kr120-viewer/);
});
