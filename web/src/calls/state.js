/**
 * What a person is called for, and when it rings. Pure: what is known of the robots and times [ms] come in.
 *
 * A call is {key, robot, kind, begun, seen, rung, gone}: `seen` once a person has looked or touched, `rung` how often it has rung, `gone`
 * when it was over [ms], null while it is there. Kinds, the most urgent first:
 *   hold      the arm holds: `screen` has a line about the cause
 *   question  a task of the building model asks
 *   plan      a plan waits for a verdict
 *   message   a new message that nobody has taken note of, and that is none of the above
 */

export const KINDS = ["hold", "question", "plan", "message"];
/** When a call that nobody has seen rings, after its begin [ms]: seven times in eight minutes, ever more rarely. */
export const RINGS = [0, 15000, 40000, 80000, 150000, 270000, 480000];
/** What a person does on this page, and what is no call for so long afterwards [ms]: its consequence. */
const OWN_FOR = 10000;
const CONSEQUENCES = {
  stop: ["hold", "message"], pause: ["hold", "message"], resume: ["message"], review: ["message"], plan_request: ["plan"],
  reset: ["message"], arm: ["message"], answer: ["message"], acknowledge: [],
};
/** A screen that is older [ms] says nothing of the present. */
const SCREEN_OLD_AFTER = 3000;
/** What is over for so long [ms] is forgotten: if it comes again, it calls again. A lost connection takes all away for a moment. */
const FORGOTTEN_AFTER = 3000;
/** Topics of messages that call as another kind, or tell what a person did. */
const OTHERWISE = ["cause", "work", "person"];
/** Level of a line for which a person is needed. */
const PERSON = 2;

/** Return the state before anything was heard. `old` are the messages by robot that were there first: they are nobody's news. */
export function begin() {
  return {calls: [], acts: [], old: {}};
}

/** Return what a robot's record (store.js) calls for, as {key, kind}; null: nothing is known of the present. */
function wantedOf(robot, now) {
  if (robot.old) return null;
  const wanted = [];
  if (robot.plan) wanted.push({kind: "plan", key: `plan ${robot.plan.id} ${robot.plan.hash}`});
  if (robot.screen && now - robot.heard.screen < SCREEN_OLD_AFTER) {
    for (const line of robot.screen) if (line.topic === "cause") wanted.push({kind: "hold", key: `hold ${line.state}`});
  }
  for (const task of robot.tasks?.tasks ?? []) {
    if (task.state === "asks") wanted.push({kind: "question", key: `question ${task.id} ${task.question ?? ""}`});
  }
  for (const {id, line, acknowledged_by: by} of robot.messages ?? []) {
    if (!by && line.level === PERSON && !OTHERWISE.includes(line.topic)) wanted.push({kind: "message", key: `message ${id}`});
  }
  return wanted;
}

/** Return the state after this page's person did something: `what` is the topic on which the page has published. */
export function acted(state, robot, what, now) {
  if (!(what in CONSEQUENCES)) return state;
  return {...state, acts: [...state.acts.filter(({at}) => now - at < OWN_FOR), {robot, what, at: now}]};
}

/**
 * Return the state after it was looked at the robots. What is wanted for the first time begins to call; what a person
 * has just caused here is seen from the start.
 *
 * @param {object[]} robots records of the store
 */
export function renewed(state, robots, now) {
  let {calls, old} = state;
  for (const robot of robots) {
    const wanted = wantedOf(robot, now);
    if (robot.messages && !(robot.name in old)) old = {...old, [robot.name]: robot.messages.map(({id}) => `message ${id}`)};
    const mine = calls.filter((call) => call.robot === robot.name);
    const others = calls.filter((call) => call.robot !== robot.name);
    if (wanted === null) {
      if (mine.length) calls = [...others, ...mine.map((call) => ({...call, gone: now}))];
      continue;
    }
    const known = wanted.filter(({key}) => !old[robot.name]?.includes(key));
    const kept = mine.map((call) => {
      const isThere = known.some(({key}) => key === call.key);
      return isThere === (call.gone === null) ? call : {...call, gone: isThere ? null : now};
    }).filter(({gone}) => gone === null || now - gone < FORGOTTEN_AFTER);
    const added = known.filter(({key}) => !mine.some((call) => call.key === key)).map(({key, kind}) => {
      const own = state.acts.some((act) => act.robot === robot.name && now - act.at < OWN_FOR && CONSEQUENCES[act.what].includes(kind));
      return {key, robot: robot.name, kind, begun: now, seen: own, rung: 0, gone: null};
    });
    calls = [...others, ...kept, ...added];
  }
  return {...state, calls, old};
}

/** Return the state after a person has looked at the page or touched it: what has rung until now rings no more. */
export function looked(state) {
  return state.calls.every(({seen}) => seen) ? state : {...state, calls: state.calls.map((call) => ({...call, seen: true}))};
}

/** Return the calls that are there, the most urgent first. */
export function present(state) {
  const there = state.calls.filter(({gone}) => gone === null);
  return there.sort((one, other) => KINDS.indexOf(one.kind) - KINDS.indexOf(other.kind) || one.begun - other.begun);
}

/** Return what rings now: the state afterwards, and the kind, "" for none. Of several the most urgent rings, for all of them. */
export function rung(state, now) {
  const due = ({seen, gone, begun, rung: times}) => !seen && gone === null && RINGS.filter((after) => now - begun >= after).length > times;
  const ringing = present(state).filter(due);
  if (ringing.length === 0) return {state, kind: ""};
  const calls = state.calls.map((call) => (
    ringing.includes(call) ? {...call, rung: RINGS.filter((after) => now - call.begun >= after).length} : call
  ));
  return {state: {...state, calls}, kind: ringing[0].kind};
}
