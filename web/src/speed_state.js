/**
 * What a person does with the speed slider of one robot, and what became of it: pure, one record per robot. Limits are whole percent
 * of the planned speed; times are milliseconds.
 *
 * To lower the limit goes out at once, and while the handle is dragged every `PACE`; it needs no moment, and the robot takes it however
 * late it comes. To raise it is a hold of `HELD_FOR` on a button: what is asked for stands beside it until then, and is forgotten
 * `FORGOTTEN_AFTER` the last touch. Somebody else's limit never sends anything by itself.
 *
 * `outcome` says what became of the newest message, in one word:
 *   none, sending, waiting, done, refused, expired, silent, not_sent, no_right, unknown     as in stop_state.js
 */

/** Least and largest limit, and a step [%]. The robot refuses less: to stand still is a pause. */
export const LEAST = 5;
export const MOST = 100;
export const STEP = 5;
/** Between two messages while the handle is dragged, how long raising is held, and the longest wait for an answer [ms]. */
export const PACE = 200;
export const HELD_FOR = 1000;
export const ANSWER_WITHIN = 1000;
/** A limit that was asked for and not confirmed is forgotten after so long without a touch [ms]. */
export const FORGOTTEN_AFTER = 10000;

/** Return the record before anything was touched. */
export function idle() {
  return {wanted: null, touchedAt: 0, unsent: false, sentAt: -Infinity, lowered: null, heldAt: null, of: null, denied: [], message: nothing()};
}

function nothing() {
  return {kind: "", id: "", limit: 0, at: 0, broker: "", answer: null, late: false};
}

/** Return a fraction as percent; the robot's may be none of the slider's steps. */
export function percentOf(fraction) {
  return Math.round(1000 * fraction) / 10;
}

/** Return the next step of the slider below or above a limit. */
export function below(percent) {
  return Math.max(LEAST, STEP * Math.ceil(percent / STEP) - STEP);
}
export function above(percent) {
  return Math.min(MOST, STEP * Math.floor(percent / STEP) + STEP);
}

/** Return the limit of people that counts for this page: that of the robot, or a lower one that is on its way there. */
export function known(record, people) {
  return record.lowered === null ? people : Math.min(people, record.lowered);
}

/** Return where the handle stands. */
export function handle(record, people) {
  return record.wanted ?? known(record, people);
}

/** Return the record after the person has moved the handle to a limit. */
export function moved(record, limit, people, at) {
  const wanted = Math.min(MOST, Math.max(LEAST, limit));
  const from = known(record, people);
  if (wanted === from) return {...record, wanted: null, unsent: false, heldAt: null, touchedAt: at};
  return {...record, wanted, unsent: wanted < from, heldAt: null, touchedAt: at};
}

/** Return the limit that has to go out now to lower it, or null. */
export function due(record, people, at) {
  if (!record.unsent || record.wanted === null || record.wanted >= known(record, people)) return null;
  return at - record.sentAt >= PACE ? record.wanted : null;
}

/** Return the limit to which a hold would raise, or null: there is nothing to raise. */
export function raise(record, people) {
  return record.wanted !== null && !record.unsent && record.wanted > known(record, people) ? record.wanted : null;
}

/** Return the record when a hold begins, of the limit `people` that is shown; it ends by `released`, or by another limit. */
export function held(record, people, at) {
  return raise(record, people) === null ? record : {...record, heldAt: at, of: people, touchedAt: at};
}

export function released(record) {
  return record.heldAt === null ? record : {...record, heldAt: null};
}

/** Return how much of the hold is over, 0 to 1. */
export function progress(record, at) {
  return record.heldAt === null ? 0 : Math.min(1, (at - record.heldAt) / HELD_FOR);
}

/** Return the limit that a hold has confirmed by now, or null. */
export function confirmed(record, people, at) {
  return progress(record, at) === 1 && record.of === people ? raise(record, people) : null;
}

/** Return the record after a message has gone out: `kind` lower or raise. */
export function sent(record, kind, limit, id, at) {
  const message = {kind, id, limit, at, broker: "sending", answer: null, late: false};
  if (kind === "raise") return {...record, heldAt: null, wanted: null, message};
  return {...record, wanted: null, unsent: false, sentAt: at, lowered: limit, message};
}

/** Return the record after the broker's word on a message: "taken", "not_shown", or the reason of NotPublished. */
export function heardBroker(record, id, word) {
  if (id !== record.message.id) return record;
  const failed = word !== "taken";
  const denied = word === "refused" ? [...record.denied, record.message.kind] : record.denied;
  return {...record, denied, message: {...record.message, broker: word}, ...(failed ? {lowered: null} : {})};
}

/** Return the record after an answer {id, account, ok, reason, expired}; one to another message changes nothing. */
export function answered(record, answer, account) {
  const {message} = record;
  if (message.id === "" || answer.id !== message.id || answer.account !== account) return record;
  const {ok = false, reason = "", expired = false} = answer;
  // what was taken counts until the robot shows it
  return {...record, message: {...message, answer: {ok, reason, expired}}, ...(ok ? {} : {lowered: null})};
}

/** Return the record at a time, with the limit of people that the robot shows now. */
export function passed(record, people, at) {
  let next = record;
  const {message} = record;
  if (message.id !== "" && !message.late && at - message.at >= ANSWER_WITHIN) next = {...next, lowered: null, message: {...message, late: true}};
  if (next.lowered !== null && people <= next.lowered) next = {...next, lowered: null};
  // somebody has changed it under the finger: look again
  if (next.heldAt !== null && next.of !== people) next = {...next, heldAt: null};
  if (next.wanted !== null && !next.unsent && (next.wanted <= people || next.heldAt === null && at - next.touchedAt >= FORGOTTEN_AFTER)) {
    next = {...next, wanted: null, heldAt: null};
  }
  return next;
}

/** Return the record after the connection has changed: nothing that was begun goes on, and another account may have the right. */
export function connectionChanged(record) {
  return {...record, wanted: null, unsent: false, lowered: null, heldAt: null, denied: []};
}

/** Return what became of the newest message, as one of the words above. */
export function outcome({message: {id, broker, answer, late}}) {
  if (id === "") return "none";
  if (answer?.ok) return "done";
  if (broker === "not_shown" || answer?.expired) return "expired";
  if (answer !== null) return "refused";
  if (broker === "not_connected") return "not_sent";
  if (broker === "refused") return "no_right";
  if (broker !== "sending" && broker !== "taken") return "unknown";
  if (late) return "silent";
  return broker === "sending" ? "sending" : "waiting";
}

/** Return why nothing can be set now, as one word, or "": offline, old, none (the robot knows no such limit). */
export function blocked({connected, view, old}) {
  if (!connected) return "offline";
  if (view === null || old || !view.online) return "old";
  return view.speed === undefined ? "none" : "";
}
