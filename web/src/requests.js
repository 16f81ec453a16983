/**
 * What this page asks of a robot by a press, and what became of it: a record per robot, of the newest request of a panel.
 *
 * A request goes out at once or not at all. `outcome` says what became of it in one word:
 *   none        nothing was asked
 *   sending     given to the broker
 *   waiting     the broker has taken it; nobody has answered yet, for less than `WITHIN`
 *   done        who carries it out has said so
 *   refused     everybody who answered says no, and the time is over
 *   expired     what starts something reached the robot too late after what the page had shown, or the page shows nothing: it is void
 *   silent      nobody has answered for so long, or the connection has ended meanwhile
 *   nobody      nobody has subscribed to requests for plans
 *   not_sent    it did NOT go out: no connection
 *   no_right    it did NOT go out: the broker refuses it to this account
 *   unknown     the connection broke before the broker answered, or the broker refused it for another reason
 */
import {setText} from "./dom.js";
import {mark} from "./texts.js";

/** Longest wait for an answer [ms], where it is no second: a session is answered when it is armed or is not, a plan when it is found. */
const WITHIN = {reset: 15000, arm: 15000, plan_request: 60000, answer: 5000, acknowledge: 5000};
const SECOND = 1000;
/** Two carry out a stop, of which one is enough: the gateway works without the robot's PC. */
const ANSWERS = {stop: 2};
/** What starts something repeats the newest moment that the page has heard: who sees nothing of the robot must look first. */
const SHOWN = ["resume", "reset", "arm", "raise_speed", "plan_request", "answer"];
const BAD = ["refused", "expired", "silent", "nobody", "not_sent", "no_right", "unknown"];
/** The broker's reason code for a message that nobody has subscribed to (MQTT 5.0, section 3.4.2.1). */
export const NOBODY = 16;
/** What is said of an outcome. */
export const SAID = {
  sending: mark("{what}: on its way ..."),
  waiting: mark("{what}: sent, no answer yet ..."),
  done: mark("{what}: carried out. {reason}"),
  refused: mark("{what} was NOT carried out: {reason}"),
  expired: mark("{what} does NOT count: what this page had shown was too old, or something has changed since. Look again, then press anew. {reason}"),
  silent: mark("{what}: NO ANSWER. Do not rely on it: look at the arm and the state above."),
  not_sent: mark("{what} did NOT go out: no connection."),
  no_right: mark("{what} did NOT go out: this account does not have the right."),
  unknown: mark("{what}: it is not known whether it went out. Look at the state above."),
};

/** Return the record before anything was asked. */
export function idle() {
  return {verb: "", id: "", at: 0, time: "", payload: {}, broker: "", answers: [], late: false};
}

/** Return the record of a request: `verb` is its topic, `id` of the message, `at` [ms], `time` of day in words. */
export function pressed(verb, id, at, payload = {}, time = "") {
  return {...idle(), verb, id, at, payload, time, broker: "sending"};
}

/** Return the record after the broker's word on the message with this id: "taken", "nobody", "not_shown", or the reason of NotPublished. */
export function heardBroker(record, id, word) {
  return id === record.id ? {...record, broker: word} : record;
}

/** Return the record after an answer {id, account, ok, reason, by, ...}; one to another request changes nothing. */
export function answered(record, answer, account) {
  if (record.verb === "" || answer.id !== record.id || answer.account !== account) return record;
  const {by = "", ok = false, reason = "", expired = false} = answer;
  return {...record, answers: [...record.answers.filter((other) => other.by !== by), {...answer, by, ok, reason, expired}]};
}

/** Return the record, marked as late after its time for an answer. */
export function markLate(record, at) {
  const isLate = record.verb !== "" && at - record.at >= (WITHIN[record.verb] ?? SECOND);
  return isLate && !record.late ? {...record, late: true} : record;
}

/** Return what became of a request, as one of the words above. */
export function outcome({verb, broker, answers, late}) {
  if (verb === "") return "none";
  if (answers.some(({ok}) => ok)) return "done";
  if (broker === "not_shown" || answers.some(({expired}) => expired)) return "expired";
  if (broker === "not_connected") return "not_sent";
  if (broker === "refused") return "no_right";
  if (!["sending", "taken", "nobody"].includes(broker)) return "unknown";
  if (answers.length > 0 && (late || answers.length >= (ANSWERS[verb] ?? 1))) return "refused";
  if (broker === "nobody" && verb === "plan_request") return "nobody";
  if (late) return "silent";
  return broker === "sending" ? "sending" : "waiting";
}

export const isBusy = (record) => ["sending", "waiting"].includes(outcome(record));

/** Return the reasons that the answers give, in the page's language. */
export const reasonsOf = ({answers}, texts) => answers.map(({reason}) => texts.reason(reason)).filter(Boolean).join("; ");

/** Say in one line what became of a request; `what` is what was pressed, `danger` what is said behind an outcome that is bad. */
export function showOutcome(element, record, texts, {what, danger = "", reason = reasonsOf(record, texts), hidden = false}) {
  const found = hidden ? "none" : outcome(record);
  const isBad = BAD.includes(found);
  element.classList.add("outcome");
  element.classList.toggle("is-bad", isBad);
  element.classList.toggle("is-done", found === "done");
  const said = found === "none" ? [] : [record.time, texts(SAID[found], {what, reason}), isBad ? danger : ""];
  setText(element, said.map((each) => each.trim()).filter(Boolean).join(" "));
}

/**
 * Make what sends a panel's requests and keeps what becomes of them.
 *
 * @param {object} clock `now`, `every`, and `time` where the time of a press is said
 * @param {string[]} acks kinds of the store that answer
 * @param {(robot: string) => void} changed something has become of a robot's request
 */
export function makeRequests(store, connection, {now, every, time = () => ""}, acks, changed) {
  const records = new Map();
  const of = (robot) => records.get(robot) ?? idle();
  const put = (robot, record) => {
    if (record === of(robot)) return;
    records.set(robot, record);
    changed(robot);
  };
  for (const kind of acks) {
    store.on(kind, (robot, answer) => put(robot, answered(of(robot), answer, connection.own(of(robot).verb).split("/")[1] ?? "")));
  }
  store.on("connection", (_, state) => {
    if (state === "connected") return;
    for (const [robot, record] of records) if (isBusy(record)) put(robot, {...record, late: true});
  });
  every(100, () => {
    for (const [robot, record] of records) put(robot, markLate(record, now()));
  });

  async function publish(robot, verb, message) {
    if (robot === "") return "not_connected";
    if (message.moment === "" && connection.state === "connected") return "not_shown";
    try {
      return await connection.publish(connection.own(verb), robot, message) === NOBODY ? "nobody" : "taken";
    } catch (error) {
      return error.reason ?? "not_connected";
    }
  }

  return {
    of,
    /** Send a request now, or not at all. */
    send(robot, verb, payload = {}) {
      const id = globalThis.crypto.randomUUID();
      const message = {id, ...payload, ...(SHOWN.includes(verb) ? {moment: store.moment(robot)} : {})};
      put(robot, pressed(verb, id, now(), payload, time()));
      publish(robot, verb, message).then((word) => put(robot, heardBroker(of(robot), id, word)));
    },
    /** Have what became of a request stay to be read at another robot; without one it is forgotten. */
    move(from, to = null) {
      if (to !== null && records.has(from)) records.set(to, of(from));
      records.delete(from);
      changed(to ?? from);
    },
  };
}
