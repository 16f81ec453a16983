/**
 * What the page knows: the newest message of each kind per robot, checked, and what the panels tell each other.
 *
 * One store for all. Who wants to know registers with `on(kind, listener)`; a listener gets `(robot, value)`, robot "" where the
 * value is of no robot. An exception of one listener ends nothing but that call: the others are told, and it is `failed`.
 *
 * Kinds from the broker: view, screen, scene, plan, rehearsal, path, tasks, messages, and answers: review_ack, stop_ack, pause_ack, reset_ack,
 * arm_ack, speed_ack, answer_ack, acknowledge_ack, plan_request_ack. A value of null means: not known (any more).
 * `path` is where the tool goes by the plan that is played. `plan` is told once its hash was checked (plan_hash.js); a plan whose hash does not fit
 * has `refused`, a word of plan_hash.js, and nothing of it may be shown or approved.
 *
 * Kinds of the page itself:
 *   connection   the connection's state has changed; value: connection.state
 *   robots       a robot was heard for the first time; value: all names
 *   selected     the robot that the panels are about; value: its name
 *   old          value true: no view for a second, what is shown is not the present; false: it is again
 *   refused      {kind, sentence}: a message was not as expected and is not shown
 *   failed       {part}: a part of the page had an exception (`failed`); told once for each exception of a part
 *   playback     {names, positions, time} or null: the pose of a plan at `time` [s] that the picture shows (playback panel)
 *   rights       the list of who may do what has come or gone (rights.js); ask `store.rightsOf`
 *   said         "whole" while a person can read the sentence that says what the arm does, "cut" where it does not fit (status panel)
 *   drawn        "seen" while a person can see the robot in the picture, else why not: a word of picture/seen.js; null: there is no
 *                picture, nothing can be seen in it ever (picture)
 *   acted        {topic}: this page publishes on the topic: stop, pause, review, plan_request, ... (connection)
 *   looked       {what, hash}: the plan of this hash was "shown" (again and again), "played" to its end (playback panel); told once
 *   goal         {names, positions} or null: the pose that is asked for, shown as a goal ghost (plan panel)
 *   picked       {element} or null: the element of the building model that is worked on, highlighted (tasks panel)
 *   model        the joints' limits and the tool's place, or {trouble}: why they are not known (planning/model.js)
 *   tap          {element, object}: an element of the building model or an object of the scene was tapped, else "" (picture)
 *
 * Times are milliseconds of one monotonic clock of this browser; a stamp of another computer is never compared with it.
 */
import {check} from "./check.js";
import {checkPlan} from "./plan_hash.js";
import {ACKNOWLEDGE_ACK, ANSWER_ACK, MESSAGES, PATH, PLAN, PLAN_REQUEST_ACK, REHEARSAL, REVIEW_ACK, SCENE, SCREEN, SPEED_ACK, STOP_ACK, VIEW, WORK} from "./schemas.js";

/** A view is old after so long [ms]. */
const OLD_AFTER = 1000;
/** Most robots: names come from topics, and a page that keeps all of them could be filled by anybody who may publish. */
const MOST_ROBOTS = 32;
/** The kind that a topic below `<prefix>/<robot>/` has. */
const KINDS = {
  "view": "view", "screen": "screen", "scene": "scene", "plan": "plan", "rehearsal": "rehearsal", "path": "path", "work/tasks": "tasks", "review/ack": "review_ack",
  "override_rehearsal/ack": "review_ack",
  "stop/ack": "stop_ack", "pause/ack": "pause_ack", "plan_request/ack": "plan_request_ack", "messages": "messages",
  "reset/ack": "reset_ack", "arm/ack": "arm_ack", "answer/ack": "answer_ack", "acknowledge/ack": "acknowledge_ack", "speed/ack": "speed_ack",
};
/** Topics below `<prefix>/+/` that the page reads, with their quality of service. */
export const TOPICS = Object.keys(KINDS).map((topic) => ({topic, qos: topic === "view" ? 0 : 1}));
/** Who may answer what is pressed: a stop has an answer of two. */
const BY = ["gateway", "executor", "bridge"];
/** Kinds whose newest value is kept. An answer is told once. */
const FROM_BROKER = ["view", "screen", "scene", "plan", "rehearsal", "path", "tasks", "messages"];
const KEPT = [...FROM_BROKER, "playback", "goal", "picked", "drawn", "said", "model"];
/** What the broker stores; without a value: there is none any more. Of anything else that it has stored the age is not known. */
const STORED = ["plan", "rehearsal", "path", "scene", "tasks", "messages"];
/** What a message must be, but a view: of that by its version. */
const SCHEMAS = {
  screen: SCREEN, scene: SCENE, plan: PLAN, rehearsal: REHEARSAL, path: PATH, tasks: WORK,
  review_ack: REVIEW_ACK, stop_ack: STOP_ACK, pause_ack: STOP_ACK, plan_request_ack: PLAN_REQUEST_ACK,
  messages: MESSAGES, reset_ack: STOP_ACK, arm_ack: STOP_ACK, answer_ack: ANSWER_ACK, acknowledge_ack: ACKNOWLEDGE_ACK, speed_ack: SPEED_ACK,
};

function expect(is, sentence) {
  if (!is) throw new TypeError(sentence);
}

const VERSION = VIEW.properties.version.const;

function checkView(view) {
  expect(view.version === VERSION, `view version ${view.version}; expected ${VERSION}. Reload the page`);
  check(VIEW, view, "view");
  // what no schema says: the lists belong together
  const {names, types} = view.joints;
  expect(types.length === names.length, "view whose joints have not one type each");
  for (const part of ["twin", "arm", "expected"]) {
    expect(view[part] === null || view[part].positions.length === names.length, `view whose ${part} has not one position per joint`);
  }
}

/** Check what no schema says of a path: each point has a time and a place. */
function checkPath({times, tool_path: points}) {
  expect(times.length === points.length, "path whose points have not one time each");
  expect(points.every((point) => point.length === 3), "path with a point that is no x, y, z");
}

/**
 * Make the store.
 *
 * @param {() => number} [options.now] milliseconds of a monotonic clock
 * @param {(plan: object) => Promise<object>} [options.check] checks a plan's hash; see plan_hash.js
 * @param {(source: string, message: object) => void} [options.hear] gets each message that was checked, before anybody is told of it, with
 *   robot, kind and, of an answer, who carries it out
 * @param {(error: Error) => void} [options.report] where exceptions of the page's parts go: the browser's console
 */
export function makeStore({
  now = () => performance.now(), check: checkHash = checkPlan, report = (error) => globalThis.reportError(error), hear = () => {},
} = {}) {
  const robots = new Map();
  const listeners = new Map();
  const plans = new Map();
  // what each part has failed with last: views come 25 times a second, and may fail each time
  const faults = new Map();
  let selected = "";
  let refused = 0;

  function tell(kind, robot, value) {
    for (const {listener, part} of [...listeners.get(kind) ?? []]) {
      try {
        listener(robot, value);
      } catch (error) {
        fail(part, error);
      }
    }
  }

  function fail(part, error) {
    const what = String(error);
    if (faults.get(part) === what) return;
    faults.set(part, what);
    report(error);
    tell("failed", "", {part});
  }

  function refuse(robot, kind, sentence) {
    refused += 1;
    tell("refused", robot, {kind, sentence});
  }

  function record(name) {
    let robot = robots.get(name);
    if (robot === undefined) {
      robot = {name, heard: {}, old: true};
      for (const kind of KEPT) robot[kind] = null;
      robots.set(name, robot);
      tell("robots", "", [...robots.keys()].sort());
      if (selected === "") store.select(name);
    }
    return robot;
  }

  function put(robot, kind, value) {
    robot[kind] = value;
    robot.heard[kind] = now();
    tell(kind, robot.name, value);
  }

  function setOld(robot, old) {
    if (robot.old === old) return;
    robot.old = old;
    tell("old", robot.name, old);
  }

  function takeView(robot, view) {
    const last = robot.view;
    // a lower number of the same run is an older one
    if (last !== null && view.online && last.run === view.run && view.seq <= last.seq) return;
    put(robot, "view", view);
    setOld(robot, !view.online);
  }

  function takePlan(robot, plan) {
    const turn = (plans.get(robot.name) ?? 0) + 1;
    plans.set(robot.name, turn);
    if (plan === null) {
      put(robot, "plan", null);
      return Promise.resolve();
    }
    // what is under review now is not the plan before any more
    if (robot.plan !== null && (robot.plan.id !== plan.id || robot.plan.hash !== plan.hash)) put(robot, "plan", null);
    return checkHash(plan).then((checked) => {
      // another may have come meanwhile
      if (plans.get(robot.name) === turn) put(robot, "plan", checked);
    });
  }

  const store = {
    /** Names of the robots that were heard, sorted. */
    get robots() {
      return [...robots.keys()].sort();
    },

    /** The robot that the panels are about; "" before the first was heard. */
    get selected() {
      return selected;
    },

    /** How many messages were not as expected. */
    get refused() {
      return refused;
    },

    /**
     * What is known of a robot: view, screen, scene, plan, rehearsal, path, tasks, messages, playback, goal,
     * picked, drawn, said, model (null: not known), `old` (the view is not the present), `heard` [ms] per kind. Null
     * for a robot that was never heard.
     */
    robot(name) {
      return robots.get(name) ?? null;
    },

    /**
     * The newest moment of a robot that this page has received, as its view has it: what starts something repeats it,
     * and the robot refuses what is too old. "" while nothing is known.
     */
    moment(name) {
      return robots.get(name)?.view?.moment ?? "";
    },

    /** Call `listener(robot, value)` at each new value of a kind; returns a function that ends it. `part` of the page it belongs to. */
    on(kind, listener, part = "page") {
      if (!listeners.has(kind)) listeners.set(kind, new Set());
      const entry = {listener, part};
      listeners.get(kind).add(entry);
      return () => listeners.get(kind).delete(entry);
    },

    /** Who may do what, as far as it is known: rights.js sets it. */
    rightsOf: {may: () => null, who: () => []},

    /** Take that the list of rights has come or gone. */
    rights(list) {
      tell("rights", "", list);
    },

    /** Take that a part of the page, by its area or `page`, had an exception. */
    failed: fail,

    /** Return the store for one part of the page: the exceptions of its listeners are its own. */
    of(part) {
      return Object.create(store, {on: {value: (kind, listener) => store.on(kind, listener, part)}});
    },

    /** Make a robot the one that the panels are about. */
    select(name) {
      if (name === selected || !robots.has(name)) return;
      selected = name;
      tell("selected", name, name);
    },

    /** Set what a panel tells the others: playback, goal, picked, drawn (kept); tap (told once). */
    set(kind, name, value) {
      const robot = robots.get(name);
      if (robot === undefined) return;
      if (KEPT.includes(kind)) put(robot, kind, value);
      else tell(kind, name, value);
    },

    /** Take that the connection has changed. Without one nothing is known: what was heard is no longer the present. */
    connection(state) {
      if (state !== "connected") {
        for (const robot of robots.values()) {
          setOld(robot, true);
          plans.set(robot.name, (plans.get(robot.name) ?? 0) + 1);
          for (const kind of FROM_BROKER) if (robot[kind] !== null) put(robot, kind, null);
        }
      }
      tell("connection", "", state);
    },

    /** Look whether views have become old; called a few times a second. */
    tick() {
      const at = now();
      for (const robot of robots.values()) {
        if (robot.view !== null && at - robot.heard.view > OLD_AFTER) setOld(robot, true);
      }
    },

    /**
     * Take a message.
     *
     * @param {boolean} retained the broker had stored it
     * @returns {Promise<void>} resolved when it was taken or refused; a plan's hash takes a moment
     */
    async take(name, topic, text, retained = false) {
      const kind = KINDS[topic];
      if (kind === undefined || !robots.has(name) && robots.size >= MOST_ROBOTS) return;
      if (retained && !STORED.includes(kind)) return;
      const robot = record(name);
      try {
        const value = text === "" ? null : JSON.parse(text);
        expect(value !== null || STORED.includes(kind), `an empty ${kind}`);
        if (value !== null) {
          if (kind === "view") checkView(value);
          else check(SCHEMAS[kind], value, kind);
          if (kind === "path") checkPath(value);
          hear(`${name} ${kind} ${BY.includes(value.by) ? value.by : ""}`, value);
        }
        if (kind === "view") takeView(robot, value);
        else if (kind === "plan") await takePlan(robot, value);
        else if (KEPT.includes(kind)) put(robot, kind, value);
        else tell(kind, name, value);
      } catch (error) {
        if (!(error instanceof SyntaxError || error instanceof TypeError)) throw error;
        // the plan before is not under review any more either
        if (kind === "plan") takePlan(robot, null);
        refuse(name, kind, error.message);
      }
    },
  };
  return store;
}
