/**
 * What panels' tests need: a document, a store that hears what a test says, a connection that notes what was published.
 *
 *   const {parent, store, connection, texts, hear, later} = fakePage();
 *   make(parent, store, connection, texts);
 *   await hear("kr120", "view", view({sync: {...}}));
 *   connection.sent[0] -> {topic, robot, payload, qos}
 */
import {Document, DOMParser, Element, parseHTML} from "linkedom";
import {NotPublished} from "../../src/connection.js";
import {makeStore} from "../../src/store.js";
import {textsIn} from "./sentences.js";

// urdf-loader takes a browser's
Object.assign(globalThis, {Document, DOMParser, Element});

/** An exception that no test expects ends it, as one that nobody has caught. */
function rethrow(error) {
  queueMicrotask(() => {
    throw error;
  });
}

/**
 * Return a document's parent element, store, connection and texts, and functions to drive them. `report` gets the exceptions of
 * listeners; without it they fail the test.
 */
export function fakePage({account = "", language = "en", check = async (plan) => ({...plan, refused: ""}), report = rethrow} = {}) {
  const {document, window} = parseHTML("<!doctype html><html><body><main></main></body></html>");
  const clock = {now: 0};
  const texts = textsIn(language);
  const store = makeStore({now: () => clock.now, check, report, hear: texts.hear});
  const connection = fakeConnection(store, account);
  // the state's sentence is on the screen, as the status panel would say
  store.on("robots", () => {
    for (const name of store.robots) if (store.robot(name).said === null) store.set("said", name, "whole");
  });
  return {
    document, window, store, connection, clock,
    parent: document.querySelector("main"),
    texts,
    /** Hear a message: `value` becomes JSON; null is an empty payload. Resolves once it is taken. */
    hear: (robot, topic, value, retained = false) => store.take(robot, topic, value === null ? "" : JSON.stringify(value), retained),
    /** Let time pass [ms] for the store. */
    later(ms) {
      clock.now += ms;
      store.tick();
    },
    /** Click as a browser does. */
    click: (element) => element.dispatchEvent(new window.Event("click", {bubbles: true, cancelable: true})),
    /** Change a field as a person does. */
    enter(element, value) {
      element.value = value;
      element.dispatchEvent(new window.Event("input", {bubbles: true}));
      element.dispatchEvent(new window.Event("change", {bubbles: true}));
    },
  };
}

/**
 * A connection that is connected until `change(state, reason)`; `sent` holds what was published. With `refuse(reason)` the next
 * publishes are rejected with it, after they were noted; with `answer(code)` they resolve with another code than 0. Without a
 * connection nothing is noted.
 */
export function fakeConnection(store, account = "") {
  let refused = null;
  let code = 0;
  const connection = {
    state: "connected", reason: "", account, sent: [],
    own: (topic) => (account === "" && topic === "review" ? topic : `${topic}/${account || "console"}`),
    change(state, reason = "") {
      connection.state = state;
      connection.reason = reason;
      store.connection(state);
    },
    refuse(reason) {
      refused = reason;
    },
    answer(newCode) {
      code = newCode;
    },
    async publish(topic, robot, payload, {qos = 1} = {}) {
      if (connection.state !== "connected") throw new NotPublished("not_connected");
      connection.sent.push({topic, robot, payload, qos});
      if (refused !== null) throw new NotPublished(refused);
      return code;
    },
    login() {},
    logout() {},
  };
  return connection;
}

let seq = 0;

/** Return a view as console_node sends it, of two joints, with what is given in place of its own. */
export function view(changes = {}) {
  seq += 1;
  return {
    version: 8, compatible: 8, moment: `c0ffee00-${1000 + 40 * seq}`, robot: "kr120", online: true, run: "run", seq, stamp: seq / 25, units: {angle: "rad", length: "m", time: "s"},
    joints: {names: ["joint_a1", "joint_a2"], types: ["revolute", "revolute"]},
    twin: {stamp: seq / 25, age: 0.01, positions: [0.1, -1.5]},
    arm: {stamp: seq / 25, age: 0.02, positions: [0.1, -1.5]},
    expected: null,
    sync: {state: "IN_SYNC", reason: "", age: 0.01, policy: "hold", agreed: true, error: [0, 0], threshold: [0.01, 0.01],
      servo_lag: 0.02, violations: 0},
    link: {state: "READY", reason: "", age: 0.5, gateway_state: "RSI", gateway_kind: "gateway", responsible: "", round_trip_ms: 8.1,
      late: 0, controller: null},
    execution: {state: "IDLE", reason: "", age: 1, plan_id: "", outcome: "", duration: 0, progress: 0, rate: null, speed_limit: 1,
      segment: null},
    plan: "", hold: null, approval_obstacle: "", overridable: false, speed: null, said: {},
    ...changes,
  };
}

/** Return a plan under review as console_node sends it, of one joint that moves in a second, with what is given in place of its own. */
export function plan(changes = {}) {
  return {
    id: "p1", hash: "h1", source: "request", planner: "RRTConnect", scene: "5ce9e0", tool: "t", frame: "base_link", created_ns: 1, duration: 1,
    planning_time: 0.1, joints: ["joint_a1"], start: [0], goal: [1], waypoints: 2, tool_path: [[0, 0, 1], [0, 1, 1]],
    clearance: null, use: {velocity: [], acceleration: [], jerk: []},
    trajectory: {times: [0, 1], positions: [[0], [1]], velocities: [[0], [0]], accelerations: [[0], [0]]},
    ...changes,
  };
}

/** Return `work/tasks` of a model with one task, of the element `beam`, with what is given in place of its own. */
export function work(changes = {}) {
  const task = {id: "1", name: "Place beam", element: "beam", element_name: "Beam", state: "ready", reason: "", after: [], robot: "",
    plan_id: "", deviation_mm: null, deviation_deg: null, question: "", answers: []};
  return {stamp: 1, model: "wall.ifc", model_hash: "h", schedule: "model", engaged: false, next: "1", reason: "", tasks: [task], notes: [],
    ...changes};
}
