/**
 * Stop, pause and resume of every robot, always there. A press goes out at once or not at all, and what became of it is told: a stop
 * that did not go out is said in red. Who may stop is the broker's to decide.
 */
import {add, clear, setText} from "../dom.js";
import {answered, heardBroker, idle, outcome, pressed, waited} from "../stop_state.js";
import {browser} from "./clock.js";

const VERBS = ["stop", "pause", "resume"];
const BAD = ["refused", "expired", "silent", "not_sent", "no_right", "unknown"];

/** Make the panel. */
export function make(parent, store, connection, texts, {now, every, time = browser.time} = browser) {
  const rows = new Map();
  // always in view, also where the line at the top of the page is not; that one is spoken
  const offline = add(parent, "p", {className: "stop-offline", text: texts("stop.offline"), hidden: true});
  const box = add(parent, "div", {className: "stop-robots"});
  add(parent, "p", {className: "stop-not-emergency", text: texts("stop.not_emergency")});

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

  // the line stays until the next press, so it says of when it is
  const show = ({press, result, at = ""}) => {
    const found = outcome(press);
    const bad = BAD.includes(found);
    result.className = `stop-result ${bad ? "is-bad" : found === "done" ? "is-done" : ""}`;
    const said = press.answers.filter(({ok}) => ok || found === "refused");
    const reasons = said.map(({by, reason}) => {
      const who = texts.has(`stop.by.${by}`) ? texts(`stop.by.${by}`) : by;
      return reason ? texts("stop.said", {who, reason: texts.reason(reason)}) : who;
    }).join("; ");
    const verb = found === "none" ? "" : texts(`stop.${press.verb}`);
    setText(result, found === "none" ? "" : texts("stop.at", {time: at, what: texts(`stop.result.${found}`, {verb, reasons})}));
  };

  const makeRow = (name) => {
    const element = add(box, "div", {className: "stop-robot", role: "group", "aria-label": name ? texts("stop.of", {robot: name}) : texts("stop.all")});
    if (name && store.robots.length > 1) add(element, "span", {className: "stop-name", text: name});
    // what was pressed before a robot was known did not go out to this one either: that stays to be read
    const row = rows.get(name) ?? {...rows.get("") ?? {press: idle()}};
    for (const verb of VERBS) {
      const label = name ? texts("stop.label", {verb: texts(`stop.${verb}`), robot: name}) : texts(`stop.${verb}`);
      const each = add(element, "button", {type: "button", className: `stop-${verb}`, "aria-label": label, text: texts(`stop.${verb}`)});
      if (verb === "stop") {
        // a finger stops when it touches, not when it is lifted; a click without a pointer is the keyboard's
        each.addEventListener("pointerdown", (event) => {
          if (event.button === 0 || event.button === undefined) send(name, verb);
        });
        each.addEventListener("click", (event) => {
          if (!event.detail) send(name, verb);
        });
      } else {
        each.addEventListener("click", () => send(name, verb));
      }
    }
    row.result = add(element, "p", {className: "stop-result", role: "alert"});
    rows.set(name, row);
    show(row);
  };

  const build = () => {
    clear(box);
    for (const name of store.robots.length ? store.robots : [""]) makeRow(name);
    if (store.robots.length) rows.delete("");
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
