/**
 * The speed limit of the robot: what is in force as the robot says it, who set it, and a slider for who may. Lowering goes out at once,
 * raising is held. What may go out when is speed_state.js; whether an account may at all is the broker's to decide.
 */
import {add, button, setText} from "../dom.js";
import {holdButton} from "../hold.js";
import {makeRequests, outcome, showOutcome} from "../requests.js";
import * as speed from "../speed_state.js";
import {mark} from "../texts.js";
import {browser} from "./clock.js";

const TICK_EVERY = 50;
/** A finger that has gone so far along the slider drags it [px]. */
const ALONG = 10;
/** The right that each way needs. */
const RIGHT = {lower: "operate", raise: "approve"};
const IN_FORCE = {
  nobody: mark("No speed limit: as fast as planned."),
  people: mark("Speed limit in force: {percent} % of the planned speed ({reason})."),
  program: mark("Speed limit in force: {percent} % of the planned speed, by a program ({reason})."),
};
const BLOCKED = {
  offline: mark("Not connected: nothing that is set here goes out."),
  old: mark("Nothing of the robot is shown now: wait until it is."),
  right: mark("This account does not have the right to set the speed limit."),
};
const ONLY = {
  lower: mark("This account may lower the limit, not raise it."),
  raise: mark("This account may raise the limit, not lower it."),
};
const PRESSED = {lower_speed: mark("Lower to {percent} %"), raise_speed: mark("Raise to {percent} %")};

/** Return what the robot says of the limit in force, as sentences. */
export function saying(view, texts, clockOf = (seconds) => new Date(1000 * seconds).toLocaleString()) {
  const said = view.speed ?? null;
  const limit = said?.limit ?? view.execution?.speed_limit ?? null;
  if (limit === null) return [texts("The speed limit in force is not known.")];
  const percent = speed.percentOf(limit).toString();
  const lines = [said === null ? texts("Speed limit in force: {percent} % of the planned speed.", {percent})
    : texts(IN_FORCE[said.by === "" ? "nobody" : said.by === "people" ? "people" : "program"], {percent, reason: texts.reason(said.reason)})];
  if (said !== null && said.person) {
    const values = {
      person: said.person, time: clockOf(said.since), people: speed.percentOf(said.people).toString(),
      replaced: speed.percentOf(said.replaced).toString(), before: said.replaced_person || texts("nobody"),
    };
    lines.push(texts("People's limit: {people} %, set by {person} on {time}; before: {replaced} % ({before}).", values));
  }
  return lines;
}

export function make(parent, store, connection, texts, clock = browser) {
  const {now, every} = clock;
  const records = new Map();
  const area = add(parent, "div", {className: "speed", role: "group", "aria-label": texts("Speed limit")});
  const title = add(area, "p", {className: "speed-now"});
  const who = add(area, "p", {className: "speed-who", hidden: true});
  const row = add(area, "div", {className: "speed-row"});
  const less = button(row, "\u2212", () => move(speed.below(place())), {className: "speed-step", "aria-label": texts("Lower the speed limit")});
  const slider = add(row, "input", {type: "range", min: speed.LEAST, max: speed.MOST, step: speed.STEP, className: "speed-slider", "aria-label": texts("Speed limit")});
  const more = button(row, "+", () => move(speed.above(place())), {className: "speed-step", "aria-label": texts("Ask for a higher speed limit")});
  const shown = add(row, "span", {className: "speed-percent", "aria-hidden": "true"});
  const confirm = holdButton(area, {
    text: "", className: "speed-raise", onHeld: () => raise(store.selected),
    // somebody has changed it under the finger: look again
    key: () => JSON.stringify([store.selected, peopleOf(store.selected), place(), why(store.selected)]),
  }, clock);
  const hint = add(area, "p", {className: "speed-hint", hidden: true});
  const result = add(area, "p", {className: "speed-result", role: "alert"});

  const recordOf = (robot) => records.get(robot) ?? speed.idle();
  const peopleOf = (robot) => speed.percentOf(store.robot(robot)?.view?.speed?.people ?? 1);
  const place = () => speed.handle(recordOf(store.selected), peopleOf(store.selected));
  const may = (robot, kind) => store.rightsOf.may(robot, RIGHT[kind]) !== false;
  const why = (robot) => {
    const found = store.robot(robot);
    if (!may(robot, "lower") && !may(robot, "raise")) return "right";
    return speed.blocked({connected: connection.state === "connected", view: found?.view ?? null, old: found?.old ?? true});
  };
  const setRecord = (robot, record) => {
    if (robot === "") return;
    records.set(robot, record);
    if (robot === store.selected) show();
  };

  const requests = makeRequests(store, connection, clock, ["speed_ack"], (robot) => {
    look(robot);
    if (robot === store.selected) show();
  });
  const raise = (robot) => {
    const limit = speed.raise(recordOf(robot), peopleOf(robot));
    if (limit === null) return;
    setRecord(robot, speed.confirmed(recordOf(robot)));
    requests.send(robot, "raise_speed", {limit: limit / 100});
  };
  const look = (robot) => {
    const people = peopleOf(robot);
    const before = recordOf(robot);
    const record = speed.passed(before, people, now(), outcome(requests.of(robot)));
    if (record !== before) setRecord(robot, record);
    const limit = why(robot) === "" ? speed.due(record, people, now()) : null;
    if (limit === null) return;
    setRecord(robot, speed.lowered(record, limit, now()));
    requests.send(robot, "lower_speed", {limit: limit / 100});
  };
  const move = (limit) => {
    const robot = store.selected;
    if (robot === "" || why(robot) !== "") return;
    const people = peopleOf(robot);
    const way = Math.sign(limit - speed.known(recordOf(robot), people));
    setRecord(robot, way === 0 || may(robot, way < 0 ? "lower" : "raise") ? speed.moved(recordOf(robot), limit, people, now()) : recordOf(robot));
    look(robot);
  };

  const show = () => {
    const robot = store.selected;
    const view = store.robot(robot)?.view ?? null;
    const record = recordOf(robot);
    const people = peopleOf(robot);
    const reason = why(robot);
    area.hidden = view === null;
    if (area.hidden) return;
    const [first, second = ""] = view.online ? saying(view, texts) : [texts("The speed limit in force is not known.")];
    setText(title, first);
    who.hidden = second === "";
    setText(who, second);
    const at = speed.handle(record, people);
    if (finger === null && Number(slider.value) !== at) slider.value = String(at);
    slider.setAttribute("aria-valuetext", `${at} %`);
    setText(shown, `${at} %`);
    slider.disabled = reason !== "";
    less.disabled = slider.disabled || !may(robot, "lower");
    more.disabled = slider.disabled || !may(robot, "raise");
    const higher = speed.raise(record, people);
    confirm.hidden = higher === null || reason !== "";
    if (higher !== null) confirm.say(texts("Hold for a second: raise to {percent} %", {percent: higher}));
    const only = less.disabled === more.disabled ? "" : less.disabled ? "raise" : "lower";
    hint.hidden = reason === "" && higher === null && only === "";
    if (!hint.hidden) setText(hint, texts(reason !== "" ? BLOCKED[reason]
      : higher === null ? ONLY[only] : mark("Raising makes the arm faster. Look at the cell first.")));
    const {verb, payload: {limit}} = requests.of(robot);
    showOutcome(result, requests.of(robot), texts, {what: verb && texts(PRESSED[verb], {percent: Math.round(100 * limit)})});
  };
  // -- the person

  // a finger that begins to scroll on the slider moves its handle at once: what it means is known when it moves along, or is lifted
  let finger = null;
  const slide = () => {
    if (finger === null && Number(slider.value) !== place()) move(Number(slider.value));
  };
  for (const kind of ["input", "change"]) slider.addEventListener(kind, slide);
  slider.addEventListener("pointerdown", (event) => {
    finger = event.pointerType === "touch" ? event.clientX : null;
  });
  slider.addEventListener("pointermove", (event) => {
    if (finger === null || Math.abs(event.clientX - finger) < ALONG) return;
    finger = null;
    slide();
  });
  slider.addEventListener("pointerup", () => {
    finger = null;
    slide();
  });
  slider.addEventListener("pointercancel", () => {
    finger = null;
    slider.value = String(place());
  });
  // -- what is heard

  store.on("connection", () => {
    for (const [robot, record] of records) records.set(robot, speed.connectionChanged(record));
    show();
  });
  store.on("selected", show);
  store.on("robots", show);
  store.on("rights", show);
  store.on("old", show);
  store.on("view", (robot, view) => {
    if (view !== null) look(robot);
    if (robot === store.selected) show();
  });
  every(TICK_EVERY, () => {
    for (const robot of records.keys()) look(robot);
  });
  show();
}
