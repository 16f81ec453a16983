/**
 * Stop, pause and resume of every robot, always there. A press goes out at once or not at all, and what became of it is told: a stop
 * that did not go out is said in red. Who may stop is the broker's to decide; drawn is what works by the list of rights (rights.js), and
 * everything where there is none.
 *
 * With several robots one button stops them all, a stop and an answer for each; pause and resume are of the robot that is shown.
 */
import {add, button, clear, setText} from "../dom.js";
import {answered, heardBroker, idle, outcome, pressed, waited} from "../stop_state.js";
import {browser} from "./clock.js";

const VERBS = ["stop", "pause", "resume"];
/** The right that a verb needs. */
const RIGHT = {stop: "stop", pause: "operate", resume: "approve"};
const BAD = ["refused", "expired", "silent", "not_sent", "no_right", "unknown"];

/** Make the panel. */
export function make(parent, store, connection, texts, {now, every, time = browser.time} = browser) {
  const rows = new Map();
  // what became of presses lies over the picture: the bar keeps its height, and no button moves
  const results = add(parent, "div", {className: "stop-results"});
  const bar = add(parent, "div", {className: "stop-bar"});
  const box = add(bar, "div", {className: "stop-robots"});
  const beside = add(bar, "div", {className: "stop-beside"});
  // always in view, also where the line at the top of the page is not; that one is spoken
  const offline = add(beside, "p", {className: "stop-offline", text: texts("stop.offline"), hidden: true});
  const who = add(beside, "p", {className: "stop-who", hidden: true});
  add(beside, "p", {className: "stop-not-emergency", text: texts("stop.not_emergency")});
  const close = button(results, "\u00d7", () => {
    for (const row of rows.values()) {
      row.press = idle();
      show(row);
    }
  }, {className: "stop-close", "aria-label": texts("stop.close")});

  const send = (name, verb) => {
    const row = rows.get(name);
    const id = globalThis.crypto.randomUUID();
    row.press = pressed(verb, id, now());
    row.at = time();
    const moment = store.moment(name);
    // a resume starts the arm: who sees nothing of it, or only what is long past, must look first
    const blind = verb === "resume" && connection.state === "connected" && name !== "" && moment === "";
    const message = verb === "resume" ? {id, moment} : {id};
    const publish = name === "" ? Promise.reject(new Error("no robot is known"))
      : blind ? Promise.reject(Object.assign(new Error("nothing of the robot is shown"), {reason: "not_shown"})) : connection.publish(connection.own(verb), name, message);
    publish.then(
      () => heardBroker(row.press, id, "taken"),
      (error) => heardBroker(row.press, id, error.reason ?? "not_connected"),
    ).then((press) => {
      row.press = press;
      show(row);
    });
    show(row);
  };

  // the line stays until the next press, so it says of when it is, and of which robot where there are several
  const show = ({name, press, result, at = ""}) => {
    const found = outcome(press);
    const bad = BAD.includes(found);
    result.className = `stop-result ${bad ? "is-bad" : found === "done" ? "is-done" : ""}`;
    const said = press.answers.filter(({ok}) => ok || found === "refused");
    const reasons = said.map(({by, reason}) => {
      const author = texts.has(`stop.by.${by}`) ? texts(`stop.by.${by}`) : by;
      return reason ? texts("stop.said", {who: author, reason: texts.reason(reason)}) : author;
    }).join("; ");
    const verb = found === "none" ? "" : texts(`stop.${press.verb}`);
    const what = found === "none" ? "" : texts(`stop.result.${found}`, {verb: name && store.robots.length > 1 ? texts("stop.label", {verb, robot: name}) : verb, reasons});
    setText(result, what && texts("stop.at", {time: at, what}));
    close.hidden = [...rows.values()].every((row) => outcome(row.press) === "none");
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
    const element = add(box, "div", {className: "stop-robot", role: "group", "aria-label": name ? texts("stop.of", {robot: name}) : texts("stop.all")});
    // what was pressed before a robot was known did not go out to this one either: that stays to be read
    const row = Object.assign(rows.get(name) ?? {...rows.get("") ?? {press: idle()}}, {name, element, buttons: {}});
    for (const verb of VERBS) {
      const label = name ? texts("stop.label", {verb: texts(`stop.${verb}`), robot: name}) : texts(`stop.${verb}`);
      const shown = several && verb === "stop" ? label : texts(`stop.${verb}`);
      if (verb === "stop") row.buttons.stop = stopButton(element, () => send(name, verb), {"aria-label": label, text: shown});
      else row.buttons[verb] = button(element, shown, () => send(name, verb), {className: `stop-${verb}`, "aria-label": label});
    }
    row.result?.remove();
    row.result = add(results, "p", {className: "stop-result", role: "alert"});
    rows.set(name, row);
    show(row);
  };

  /** Draw what works: for a robot that is not shown its stop alone. */
  const arrange = () => {
    for (const {name, element, buttons} of rows.values()) {
      const selected = name === "" || name === store.selected;
      element.classList.toggle("is-selected", selected);
      for (const verb of VERBS) buttons[verb].hidden = !may(name, verb) || (verb !== "stop" && !selected);
    }
    const none = store.robots.length > 0 && !may(store.selected, "stop");
    who.hidden = !none;
    const names = none ? store.rightsOf.who(store.selected, "stop") : [];
    setText(who, none ? texts(names.length ? "stop.who" : "stop.nobody", {who: names.join(", ")}) : "");
  };

  const build = () => {
    clear(box);
    const names = store.robots.length ? store.robots : [""];
    if (names.length > 1 && names.some((name) => may(name, "stop"))) {
      const all = () => names.filter((name) => may(name, "stop")).forEach((name) => send(name, "stop"));
      stopButton(box, all, {text: texts("stop.stop_all"), className: "stop-stop stop-all"});
    }
    for (const name of names) makeRow(name);
    if (store.robots.length) {
      rows.get("")?.result.remove();
      rows.delete("");
    }
    arrange();
  };
  const onAnswer = (robot, answer) => {
    const row = rows.get(robot);
    if (row === undefined) return;
    row.press = answered(row.press, answer, connection.own("stop").split("/")[1] ?? "");
    show(row);
  };
  const showConnection = () => {
    offline.hidden = connection.state === "connected";
  };
  store.on("connection", showConnection);
  store.on("robots", build);
  store.on("rights", build);
  store.on("selected", arrange);
  store.on("stop_ack", onAnswer);
  store.on("pause_ack", onAnswer);
  every(100, () => {
    for (const row of rows.values()) {
      const press = waited(row.press, now());
      if (press === row.press) continue;
      row.press = press;
      show(row);
    }
  });
  showConnection();
  build();
}
