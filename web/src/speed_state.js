/**
 * What a person does with the speed slider of one robot: pure, one record per robot. Limits are whole percent of the
 * planned speed; times are milliseconds.
 *
 * To lower the limit goes out at once, and while the handle is dragged every `PACE`; it needs no moment, and the robot
 * takes it however late it comes. To raise it is a button that is held: what is asked for stands beside it until then,
 * and is forgotten `FORGOTTEN_AFTER` the last touch. Somebody else's limit never sends anything by itself.
 */

/** Least and largest limit, and a step [%]. The robot refuses less: to stand still is a pause. */
export const LEAST = 5;
export const MOST = 100;
export const STEP = 5;
/** Between two messages while the handle is dragged, and the longest wait for an answer [ms]. */
export const PACE = 200;
export const ANSWER_WITHIN = 1000;
/** A limit that was asked for and not confirmed is forgotten after so long without a touch [ms]. */
export const FORGOTTEN_AFTER = 10000;

/** Return the record before anything was touched. */
export function idle() {
  return {wanted: null, touchedAt: 0, unsent: false, sentAt: -Infinity, lowered: null};
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
  if (wanted === from) return {...record, wanted: null, unsent: false, touchedAt: at};
  return {...record, wanted, unsent: wanted < from, touchedAt: at};
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

/** Return the record after a lower limit has gone out. */
export function lowered(record, limit, at) {
  return {...record, wanted: null, unsent: false, sentAt: at, lowered: limit};
}

/** Return the record after a raise has gone out. */
export function confirmed(record) {
  return {...record, wanted: null};
}

/** Return the record at a time, with the limit of people that the robot shows now, and what became of the newest request. */
export function passed(record, people, at, outcome) {
  let next = record;
  // what was taken counts until the robot shows it
  const isUnderWay = ["sending", "waiting", "done"].includes(outcome) && at - record.sentAt < ANSWER_WITHIN;
  if (next.lowered !== null && (people <= next.lowered || !isUnderWay)) next = {...next, lowered: null};
  if (next.wanted !== null && !next.unsent && (next.wanted <= people || at - next.touchedAt >= FORGOTTEN_AFTER)) next = {...next, wanted: null};
  return next;
}

/** Return the record after the connection has changed: nothing that was begun goes on. */
export function connectionChanged(record) {
  return {...record, wanted: null, unsent: false, lowered: null};
}

/** Return why nothing may be set now, as one word, or "": offline, old. */
export function blocked({connected, view, old}) {
  if (!connected) return "offline";
  return view === null || old || !view.online ? "old" : "";
}
