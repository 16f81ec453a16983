/**
 * What became of a press on stop, pause, resume, reset or arm: pure, one record per press and robot.
 *
 * A press goes out at once or not at all. `outcome` says it in one word:
 *   none        nothing was pressed
 *   sending     given to the broker
 *   waiting     the broker has taken it; nobody has answered yet, for less than a second (a reset or arm: 15 s)
 *   done        who carries it out has said so
 *   refused     everybody who answered says no, and the second is over
 *   expired     a resume, reset or arm that reached the robot too late after what the page had shown: it is void
 *   silent      nobody has answered for so long
 *   not_sent    it did NOT go out: no connection
 *   no_right    it did NOT go out: the broker refuses it to this account
 *   unknown     the connection broke before the broker answered, or the broker refused it for another reason
 */

/** Longest wait for an answer [ms]; a session is answered when it is armed or is not, which takes the bridge's `reset_timeout`. */
export const ANSWER_WITHIN = 1000;
const SESSION_WITHIN = 15000;
/** Who carries it out, by what was pressed. For a stop one of them is enough, and the gateway works without the robot's PC. */
const BY = {stop: ["gateway", "executor"], pause: ["executor"], resume: ["executor"], reset: ["bridge"], arm: ["bridge"]};

/** Return the record before anything was pressed. */
export function idle() {
  return {verb: "", id: "", at: 0, broker: "", answers: [], late: false};
}

/** Return the record of a press: `verb` one of `BY`, `id` of the message, `at` [ms]. */
export function pressed(verb, id, at) {
  return {verb, id, at, broker: "sending", answers: [], late: false};
}

/**
 * Return the record after the broker's word on the message with this id: "taken", "not_shown" (the page knows nothing of the
 * robot now, and has sent nothing), or the reason of NotPublished.
 */
export function heardBroker(press, id, word) {
  return id === press.id ? {...press, broker: word} : press;
}

/** Return the record after an answer {id, account, ok, reason, by}; one to another press changes nothing. */
export function answered(press, answer, account) {
  if (press.verb === "" || answer.id !== press.id || answer.account !== account) return press;
  const others = press.answers.filter(({by}) => by !== answer.by);
  const {by, ok = false, reason = "", expired = false} = answer;
  return {...press, answers: [...others, {by, ok, reason, expired}]};
}

/** Return the record at a time: after a second without an answer it is late. */
export function waited(press, at) {
  const within = BY[press.verb]?.[0] === "bridge" ? SESSION_WITHIN : ANSWER_WITHIN;
  return !press.late && press.verb !== "" && at - press.at >= within ? {...press, late: true} : press;
}

/** Return what became of a press, as one of the words above. */
export function outcome({verb, broker, answers, late}) {
  if (verb === "") return "none";
  if (answers.some(({ok}) => ok)) return "done";
  if (broker === "not_shown" || answers.some(({expired}) => expired)) return "expired";
  if (broker === "not_connected") return "not_sent";
  if (broker === "refused") return "no_right";
  if (broker !== "sending" && broker !== "taken") return "unknown";
  const all = BY[verb].every((by) => answers.some((answer) => answer.by === by));
  if (answers.length > 0 && (late || all)) return "refused";
  if (late) return "silent";
  return broker === "sending" ? "sending" : "waiting";
}
