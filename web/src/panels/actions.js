/**
 * What a person can do about what the state says: lift a stop or a fault (`reset`), arm a bare PLC. Held to confirm, in
 * the name of the account; whether it may is the broker's to decide, and whether it counts the robot's. Below stands
 * whose stop it lifts: the state's own reason.
 */
import {add, setText} from "../dom.js";
import {holdButton} from "../hold.js";
import {isBusy, makeRequests, outcome, showOutcome} from "../requests.js";
import {whoCan} from "../rights.js";
import {mark} from "../texts.js";
import {browser} from "./clock.js";

const VERBS = {reset: mark("Reset"), arm: mark("Arm")};

/** What a person can do: the link waits for a reset, or a bare PLC to be armed, or the gate does not go on without a reset. */
export function waitsFor(view) {
  if (view?.link?.state === "NEEDS_RESET") return [view.link.gateway_kind === "plc" ? "arm" : "reset"];
  // an armed link has nothing to arm
  return view?.link?.state === "ARMED" && view.sync?.state === "STOPPED" ? ["reset"] : [];
}

export function make(parent, store, connection, texts, clock = browser) {
  const box = add(parent, "div", {className: "actions", role: "group", "aria-label": texts("What you can do"), hidden: true});
  const whose = add(box, "p", {className: "actions-who", hidden: true});
  const said = add(box, "p", {className: "actions-result", role: "alert"});
  const buttons = Object.fromEntries(Object.entries(VERBS).map(([verb, words]) => [verb, holdButton(box, {
    text: texts(words), className: `action action-${verb}`, onHeld: () => requests.send(store.selected, verb),
    // another stop meanwhile is another thing to lift
    key: () => JSON.stringify([store.selected, link()?.reason, link()?.state, waitsFor(store.robot(store.selected)?.view)]),
  }, clock)]));

  const link = () => store.robot(store.selected)?.view?.link ?? null;
  const requests = makeRequests(store, connection, clock, Object.keys(VERBS).map((verb) => `${verb}_ack`), () => show());

  function show() {
    const robot = store.robot(store.selected);
    const record = requests.of(store.selected);
    const found = outcome(record);
    const open = robot?.old === false && connection.state === "connected" ? waitsFor(robot.view) : [];
    const waits = open.length > 0;
    const may = store.rightsOf.may(store.selected, "reset") !== false;
    box.hidden = !waits && (found === "none" || found === "done" || isBusy(record));
    for (const verb of Object.keys(VERBS)) {
      buttons[verb].hidden = !open.includes(verb) || !may;
      buttons[verb].disabled = !open.includes(verb) || isBusy(record);
    }
    whose.hidden = !waits || may;
    setText(whose, `${texts("This account may not reset.")} ${whoCan(store.rightsOf.who(store.selected, "reset"), texts)}`);
    showOutcome(said, record, texts, {what: record.verb && texts(VERBS[record.verb]), hidden: found === "done" && !waits});
  }

  for (const kind of ["view", "old", "connection", "selected", "robots", "rights"]) store.on(kind, show);
  show();
}
