/**
 * What a person can do about what the state says: lift a stop or a fault (`reset`), arm a bare PLC. Held to confirm, in the name of the account;
 * whether it may is the broker's to decide, and whether it counts the robot's. Below stands whose stop it lifts: the state's own reason.
 */
import {add, clear, setText} from "../dom.js";
import {holdButton} from "../hold.js";
import {answered, heardBroker, idle, outcome, pressed, waited} from "../stop_state.js";
import {browser} from "./clock.js";

const VERBS = ["reset", "arm"];
const BAD = ["refused", "expired", "silent", "not_sent", "no_right", "unknown"];

/** What a person can do: the link waits for a reset, or a bare PLC to be armed, or the gate does not go on without a reset. */
export function waitsFor(view) {
  if (view?.link?.state === "NEEDS_RESET") return [view.link.gateway_kind === "plc" ? "arm" : "reset"];
  // an armed link has nothing to arm
  return view?.link?.state === "ARMED" && view.sync?.state === "STOPPED" ? ["reset"] : [];
}

/** Make the panel. */
export function make(parent, store, connection, texts, clock = browser) {
  const {now, every} = clock;
  const presses = new Map();
  const box = add(parent, "div", {className: "actions", role: "group", "aria-label": texts("actions.title"), hidden: true});
  const whose = add(box, "p", {className: "actions-who", hidden: true});
  const said = add(box, "p", {className: "actions-result", role: "alert"});
  const buttons = Object.fromEntries(VERBS.map((verb) => [verb, holdButton(box, {
    text: texts(`actions.${verb}`), className: `action action-${verb}`, onHeld: () => send(verb),
    // another stop meanwhile is another thing to lift
    key: () => JSON.stringify([store.selected, link()?.reason, link()?.state, waitsFor(store.robot(store.selected)?.view)]),
  }, clock)]));

  const link = () => store.robot(store.selected)?.view?.link ?? null;
  const pressOf = (robot) => presses.get(robot) ?? idle();

  function send(verb) {
    const robot = store.selected;
    const id = globalThis.crypto.randomUUID();
    const moment = store.moment(robot);
    presses.set(robot, pressed(verb, id, now()));
    const sent = moment === "" ? Promise.reject(Object.assign(new Error("nothing of the robot is shown"), {reason: "not_shown"}))
      : connection.publish(connection.own(verb), robot, {id, moment});
    sent.then(
      () => heardBroker(pressOf(robot), id, "taken"),
      (error) => heardBroker(pressOf(robot), id, error.reason ?? "not_connected"),
    ).then((press) => {
      presses.set(robot, press);
      show();
    });
    show();
  }

  function show() {
    const robot = store.robot(store.selected);
    const press = pressOf(store.selected);
    const found = outcome(press);
    const open = robot?.old === false && connection.state === "connected" ? waitsFor(robot.view) : [];
    const waits = open.length > 0;
    const may = store.rightsOf.may(store.selected, "reset") !== false;
    box.hidden = !waits && !BAD.includes(found);
    for (const verb of VERBS) {
      buttons[verb].hidden = !open.includes(verb) || !may;
      buttons[verb].disabled = !open.includes(verb) || found === "sending" || found === "waiting";
    }
    const none = waits && !may;
    whose.hidden = !none;
    const who = none ? store.rightsOf.who(store.selected, "reset") : [];
    setText(whose, none ? texts(who.length ? "actions.who" : "actions.nobody", {who: who.join(", ")}) : "");
    const reasons = press.answers.map(({reason}) => texts.reason(reason)).filter(Boolean).join("; ");
    const verb = press.verb === "" ? "" : texts(`actions.${press.verb}`);
    said.className = `actions-result ${BAD.includes(found) ? "is-bad" : found === "done" ? "is-done" : ""}`;
    setText(said, found === "none" || (found === "done" && !waits) ? "" : texts(`actions.result.${found}`, {verb, reasons}));
  }

  for (const verb of VERBS) {
    store.on(`${verb}_ack`, (robot, answer) => {
      const press = pressOf(robot);
      const next = answered(press, answer, connection.own(verb).split("/")[1] ?? "");
      if (next === press) return;
      presses.set(robot, next);
      show();
    });
  }
  for (const kind of ["view", "old", "connection", "selected", "robots", "rights"]) store.on(kind, show);
  every(100, () => {
    for (const [robot, press] of presses) {
      const next = waited(press, now());
      if (next === press) continue;
      presses.set(robot, next);
      show();
    }
  });
  show();
}
