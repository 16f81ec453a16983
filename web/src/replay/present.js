/**
 * What of the present ends a replay: whoever looks at a recording must not miss that the arm holds, stops or moves, or that a plan
 * waits. Pure.
 */

/** States of the gate in which something is wrong. */
const CLOSED = ["HOLDING", "REPLANNING", "STALE", "STOPPED", "FAULT"];
/** States of the executor in which the arm does not move, and nothing was begun. */
const RESTING = ["IDLE", "WAITING"];
const ENDED = ["stopped", "held", "dropped"];

/**
 * Return what the present asks a person to see: `word` "" (nothing), plan, moves, hold or stop; `key` is another one whenever it is
 * something else or has happened anew.
 */
export function presentOf(robot) {
  const {view, plan} = robot ?? {view: null, plan: null};
  if (plan !== null || view?.plan) return {word: "plan", key: `plan ${plan?.id ?? view.plan}`};
  if (!view?.online) return {word: "", key: ""};
  const {execution, sync} = view;
  if (execution && !RESTING.includes(execution.state)) {
    return {word: execution.state === "STOPPING" || execution.state === "HELD" ? "stop" : "moves", key: `${execution.state} ${execution.plan_id}`};
  }
  if (sync && CLOSED.includes(sync.state)) return {word: "hold", key: `hold ${sync.state} ${sync.violations}`};
  if (execution && ENDED.includes(execution.outcome)) return {word: "stop", key: `${execution.outcome} ${execution.plan_id}`};
  return {word: "", key: ""};
}

/** Whether a replay may not even begin: the picture of the present is needed now. */
export function isNeeded({word}) {
  return word === "plan" || word === "moves";
}
