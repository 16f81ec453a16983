/**
 * Stop, pause and resume of every robot, always there. A press goes out at once or not at all, and what became of it is
 * told: a stop that did not go out is said in red. Who may stop is the broker's to decide; drawn is what works by the
 * list of rights (rights.js), and everything where there is none.
 *
 * With several robots one button stops them all, a stop and an answer for each; pause and resume are of the robot that
 * is shown.
 */
import {add, button, clear, setText} from "../dom.js";
import {makeRequests, outcome, showOutcome} from "../requests.js";
import {whoCan} from "../rights.js";
import {mark} from "../texts.js";
import {browser} from "./clock.js";

const VERBS = {stop: mark("Stop"), pause: mark("Pause"), resume: mark("Resume")};
/** Who carries it out. */
const BY = {gateway: mark("Controller side"), executor: mark("Motion")};
/** The right that a verb needs. */
const RIGHT = {stop: "stop", pause: "operate", resume: "approve"};

export function make(parent, store, connection, texts, clock = browser) {
  const rows = new Map();
  // what became of presses lies over the picture: the bar keeps its height, and no button moves
  const results = add(parent, "div", {className: "stop-results"});
  const bar = add(parent, "div", {className: "stop-bar"});
  const box = add(bar, "div", {className: "stop-robots"});
  const beside = add(bar, "div", {className: "stop-beside"});
  // always in view, also where the line at the top of the page is not; that one is spoken
  const offline = add(beside, "p", {className: "stop-offline", text: texts("NOT CONNECTED: nothing that is pressed here goes out."), hidden: true});
  const who = add(beside, "p", {className: "stop-who", hidden: true});
  add(beside, "p", {className: "stop-not-emergency", text: texts("This is not an emergency stop. It needs network, programs and broker; the emergency stop is on the pendant and at the cell.")});
  const close = button(results, "\u00d7", () => {
    for (const name of rows.keys()) requests.move(name);
  }, {className: "stop-close", "aria-label": texts("Close these lines")});

  const requests = makeRequests(store, connection, clock, ["stop_ack", "pause_ack"], (name) => show(name));

  // the line stays until the next press, so it says of when it is, and of which robot where there are several
  const show = (name) => {
    const row = rows.get(name);
    if (row === undefined) return;
    const record = requests.of(name);
    const said = record.answers.filter(({ok}) => ok || outcome(record) === "refused");
    const reason = said.map(({by, reason: why}) => [texts.word(BY, by), texts.reason(why)].filter(Boolean).join(": ")).join("; ");
    const verb = record.verb && texts(VERBS[record.verb]);
    const what = verb && name && store.robots.length > 1 ? `${verb} ${name}` : verb;
    showOutcome(row.result, record, texts, {what, reason, danger: texts("Use the emergency stop if there is danger.")});
    close.hidden = [...rows.keys()].every((each) => outcome(requests.of(each)) === "none");
  };

  const stopButton = (place, onStop, options) => {
    const each = add(place, "button", {type: "button", className: "stop-stop", ...options});
    // a finger stops when it touches, not when it is lifted; a click without a pointer is the keyboard's
    each.addEventListener("pointerdown", (event) => {
      if (event.button === 0 || event.button === undefined) onStop();
    });
    each.addEventListener("click", (event) => {
      if (!event.detail) onStop();
    });
    return each;
  };
  const may = (name, verb) => name === "" || store.rightsOf.may(name, RIGHT[verb]) !== false;

  const makeRow = (name) => {
    const several = store.robots.length > 1;
    const group = [texts("Stop, pause, resume"), name].filter(Boolean).join(": ");
    const element = add(box, "div", {className: "stop-robot", role: "group", "aria-label": group});
    const row = Object.assign(rows.get(name) ?? {}, {name, element, buttons: {}});
    for (const [verb, words] of Object.entries(VERBS)) {
      const label = `${texts(words)} ${name}`.trim();
      const shown = several && verb === "stop" ? label : texts(words);
      if (verb === "stop") row.buttons.stop = stopButton(element, () => requests.send(name, verb), {"aria-label": label, text: shown});
      else row.buttons[verb] = button(element, shown, () => requests.send(name, verb), {className: `stop-${verb}`, "aria-label": label});
    }
    row.result?.remove();
    row.result = add(results, "p", {className: "stop-result", role: "alert"});
    rows.set(name, row);
    show(name);
  };

  /** Draw what works: for a robot that is not shown its stop alone. */
  const arrange = () => {
    for (const {name, element, buttons} of rows.values()) {
      const selected = name === "" || name === store.selected;
      element.classList.toggle("is-selected", selected);
      for (const verb of Object.keys(VERBS)) buttons[verb].hidden = !may(name, verb) || (verb !== "stop" && !selected);
    }
    who.hidden = store.robots.length === 0 || may(store.selected, "stop");
    setText(who, `${texts("This account cannot stop.")} ${whoCan(store.rightsOf.who(store.selected, "stop"), texts)}`);
  };

  const build = () => {
    clear(box);
    const names = store.robots.length ? store.robots : [""];
    if (names.length > 1 && names.some((name) => may(name, "stop"))) {
      const all = () => names.filter((name) => may(name, "stop")).forEach((name) => requests.send(name, "stop"));
      stopButton(box, all, {text: texts("Stop ALL"), className: "stop-stop stop-all"});
    }
    for (const name of names) makeRow(name);
    if (store.robots.length && rows.has("")) {
      rows.get("").result.remove();
      rows.delete("");
      // what was pressed before a robot was known did not go out to this one either: that stays to be read
      requests.move("", store.robots[0]);
    }
    arrange();
  };
  const showConnection = () => {
    offline.hidden = connection.state === "connected";
  };
  store.on("connection", showConnection);
  store.on("robots", build);
  store.on("rights", build);
  store.on("selected", arrange);
  showConnection();
  build();
}
