/**
 * When a person may give a verdict on a plan, and what became of it: one table of state, event, guard, action and next state.
 *
 * Pure: time is in the events (`at`, milliseconds of a monotonic clock); what shall be sent is returned. One machine per robot.
 *
 * Events, all with `at`:
 *   connected, disconnected
 *   plan {plan: {id, hash, refused} or null}   from the store; `refused`: why it cannot be shown, else ""
 *   view {plan: id, obstacle, overridable, ended}  a view came; id of the plan under review, "" for none; undefined: it does not
 *                                              say; `obstacle`: why it could not be approved now, "" when it could; `overridable`:
 *                                              that is its rehearsal, in spite of which some may approve; `ended`: id of the last
 *                                              plan that has ended
 *   old                                        no view for a second
 *   shows {what}                               "" while the person can see the picture and read the sentence; else why approving is
 *                                              blocked: "unseen" or "unread"
 *   looked {what, hash}                        the page showed the plan of this hash: "shown" (again and again), "played" (to its
 *                                              end), "checks" (its checks were opened)
 *   press {reviewer}, release                  of the approve button
 *   press {reviewer, override: true, reason, rehearsal}  of the button that approves in spite of the rehearsal; `rehearsal`: hash of
 *                                              the result that the page shows, "" for none
 *   rehearsal {rehearsal}                      from now on the page shows the result of this hash
 *   reject {reason, reviewer}
 *   tick {reviewer, account, sender}           again and again; `reviewer` is the person's name, `account` this page's, `sender` the one
 *                                              in whose name it approves in spite of a rehearsal
 *   taken, failed {reason}                     what the broker says to the message
 *   ack {ack}                                  an answer on review/ack or override_rehearsal/ack
 */

/** A plan must have been shown for so long before it can be approved [ms]. */
export const SHOWN_FOR = 1000;
/** The approve button must be held for so long [ms]. */
export const HELD_FOR = 1000;
/** Longest wait for the executor's answer [ms]. */
export const ANSWER_WITHIN = 5000;
/** Two reports of a plan shown must not be further apart to count [ms]. */
const LONGEST_GAP = 500;
/**
 * A page that stands still sees no release: the tick after a longer gap sends nothing, and the one after it only if no
 * release came meanwhile [ms]. A press in which it stood still for longer than this is over [ms].
 */
const SHORT_GAP = 400;
const STOOD_STILL = 2000;

const NOT_LOOKED = {shownFor: 0, shownAt: null, played: false, checks: false};

/** Return the machine of a robot of which nothing is known. */
export function begin() {
  return {
    state: "offline", plan: null, gone: false, viewPlan: undefined, obstacle: "", overridable: false, hides: "", live: false,
    ...NOT_LOOKED, pressedAt: null, tickedAt: null, override: false, reason: "", rehearsal: "", sent: null,
    notice: null,
  };
}

/**
 * Return why approving is not possible now, as a short word; "" when it is. `override`: approving in spite of the rehearsal.
 *
 * Words: offline, none, unfit, decided, sending, old (no view of the arm), view (the view names another plan, or none), obstacle (the executor would refuse it), unseen (the picture is not in view), unread (the sentence is cut off
 * or old), look, shown
 */
export function blocked(machine, override = false) {
  if (["offline", "none", "unfit", "decided"].includes(machine.state)) return machine.state;
  if (machine.state === "sending" || machine.state === "waiting") return "sending";
  if (!machine.live) return "old";
  if (machine.viewPlan !== undefined && machine.viewPlan !== machine.plan.id) return "view";
  if (machine.obstacle !== "" && !(override && machine.overridable)) return "obstacle";
  if (machine.hides !== "") return machine.hides;
  if (!machine.played && !machine.checks) return "look";
  return machine.shownFor >= SHOWN_FOR ? "" : "shown";
}

// -- guards

const isUsable = (machine, {plan}) => plan !== null && plan.refused === "";
const isUnfit = (machine, {plan}) => plan !== null && plan.refused !== "";
const isSame = (machine, {plan}) => plan !== null && machine.plan !== null && plan.id === machine.plan.id
  && plan.hash === machine.plan.hash && plan.refused === machine.plan.refused;
const isGone = (machine, {plan}) => plan === null;
const mayApprove = (machine) => blocked(machine, machine.override) === "";
/** On a broker without accounts the person's name is typed; without one nobody would be on record. */
const isNamed = ({reviewer}) => reviewer !== "";
const mayPress = (machine, event) => isNamed(event)
  && (event.override ? machine.overridable && event.reason.trim() !== "" && blocked(machine, true) === "" : blocked(machine) === "");
/** Who approves in spite of what a rehearsal says has read just that. */
const saysOther = ({override, obstacle}, event) => override && (event.obstacle ?? "") !== obstacle;
const isOther = ({override, rehearsal}, event) => override && event.rehearsal !== rehearsal;
const isHeld = (machine, {at}) => mayApprove(machine) && at - machine.pressedAt >= HELD_FOR && at - machine.tickedAt <= SHORT_GAP;
const stood = (machine, {at}) => at - machine.tickedAt > STOOD_STILL;
const isLate = (machine, {at}) => at - machine.sent.at >= ANSWER_WITHIN;
const hasReason = (machine, event) => event.reason.trim() !== "" && isNamed(event);
const isOwn = ({sent}, {ack}) => sent !== null && (ack.account ?? "") === sent.account && ack.plan_id === sent.plan.id
  && ack.plan_hash === sent.plan.hash && ack.verdict === sent.verdict && (sent.account !== "" || ack.reviewer === sent.reviewer);
const isOwnTaken = (machine, event) => isOwn(machine, event) && event.ack.ok === true;
const isOwnRefused = (machine, event) => isOwn(machine, event) && event.ack.ok !== true;
const isOthers = ({plan}, {ack}) => plan !== null && ack.ok === true && ack.plan_id === plan.id && ack.plan_hash === plan.hash;
/** An answer that comes after it was given up waiting for: the executor's disk may have hung. */
const isLateOwn = ({notice}, event) => notice?.kind === "unanswered" && isOwn({sent: notice.sent}, event);
const isLateTaken = (machine, event) => isLateOwn(machine, event) && event.ack.ok === true;
const isLateRefused = (machine, event) => isLateOwn(machine, event) && event.ack.ok !== true;
/** An answer without a plan is to a message of this account that could not be read; while we wait for one it is ours. */
const isUnread = ({sent}, {ack}) => ack.ok !== true && ack.plan_id === "" && (ack.account ?? "") === sent.account;

// -- actions: they return what changes of the machine

const forget = () => ({...NOT_LOOKED, pressedAt: null});
/** What a person must still read when a plan comes: after a lost connection, or after a press that another plan ended. */
const isLasting = (notice) => ["unknown", "unanswered"].includes(notice?.kind) || ["offline", "plan"].includes(notice?.why);
const takePlan = (machine, {plan}) => ({...forget(), plan, gone: false, notice: isLasting(machine.notice) ? machine.notice : null});
const takeFurther = (machine, event) => ({...takePlan(machine, event), sent: null, notice: {kind: "unknown", verdict: machine.sent.verdict}});
const dropPlan = ({notice}) => ({...forget(), plan: null, notice: notice?.kind === "cancelled" ? null : notice});
const losePlan = () => ({gone: true});
const keepPlan = () => ({gone: false});
const leave = () => ({
  ...forget(), plan: null, gone: false, live: false, viewPlan: undefined, obstacle: "", overridable: false, sent: null,
});
const leaveUnknown = (machine) => ({...leave(), notice: {kind: "unknown", verdict: machine.sent.verdict}});
const leavePressing = () => ({...leave(), notice: {kind: "cancelled", why: "offline"}});
const see = (machine, {plan, obstacle = "", overridable = false, ended = ""}) => {
  const other = machine.plan !== null && plan !== undefined && plan !== machine.plan.id;
  // that an approval was accepted is news until its plan has ended
  const over = machine.notice?.kind === "accepted" && machine.notice.plan === ended;
  return {...(other ? forget() : {}), ...(over ? {notice: null} : {}), live: true, viewPlan: plan, obstacle, overridable};
};
const grow = (machine, {at, what, hash}) => {
  if (machine.plan === null || hash !== machine.plan.hash) return {shownAt: null};
  if (what === "played" || what === "checks") return {[what]: true};
  const gap = machine.shownAt === null ? Infinity : at - machine.shownAt;
  return {shownAt: at, shownFor: machine.shownFor + (gap <= LONGEST_GAP ? gap : 0)};
};
const blind = () => ({live: false});
const hide = (machine, {what}) => ({hides: what});
const press = (machine, {at, override = false, reason = "", rehearsal = ""}) => ({
  pressedAt: at, tickedAt: at, override, reason, rehearsal, notice: null,
});
const note = (machine, {at}) => ({tickedAt: at});
const cancel = (why) => () => ({pressedAt: null, notice: {kind: "cancelled", why}});
const cancelWith = (action, why) => (machine, event) => ({...action(machine, event), pressedAt: null, notice: {kind: "cancelled", why}});
const sending = (machine, {at, reviewer}, verdict, account, reason, override) => ({
  pressedAt: null, notice: null, sent: {plan: machine.plan, verdict, reviewer, account, at, override},
  publish: {plan_id: machine.plan.id, plan_hash: machine.plan.hash, verdict, reviewer, reason: reason.trim(),
    ...(override ? {rehearsal_hash: machine.rehearsal} : {})},
});
const approve = (machine, event) => (machine.override
  ? sending(machine, event, "approved", event.sender, machine.reason, true) : sending(machine, event, "approved", event.account, "", false));
const reject = (machine, event) => sending(machine, event, "rejected", event.account, event.reason, false);
const fail = (machine, {reason}) => ({...forget(), sent: null, notice: {kind: "failed", reason, verdict: machine.sent.verdict}});
const wait = (machine, {at}) => ({sent: {...machine.sent, at}});
const giveUp = (machine) => ({...forget(), sent: null, notice: {kind: "unanswered", verdict: machine.sent.verdict, sent: machine.sent}});
const win = (machine, {ack}) => ({sent: null, notice: {kind: "accepted", verdict: ack.verdict, reason: ack.reason, plan: ack.plan_id}});
/** What an answer that says no tells; `expired`: it came too late after what the page had shown, and a person must look again. */
const refusalNotice = ({verdict}, {ack: {expired, reason}}) => ({kind: expired === true ? "expired" : "refused", verdict, reason});
/** What was looked at stays looked at, unless the answer says that it is too long ago. */
const lose = ({notice, sent}, event) => ({
  ...(event.ack.expired === true ? forget() : {pressedAt: null}), sent: null,
  notice: notice?.kind === "other" ? {...notice, reason: event.ack.reason} : refusalNotice(sent, event),
});
const noteLateRefusal = ({notice}, event) => ({notice: refusalNotice(notice, event)});
const yieldTo = (machine, {ack}) => ({
  ...forget(), notice: {kind: "other", verdict: ack.verdict, account: ack.account || ack.reviewer || "", reason: ""},
});

/** Where a plan leads back to after a verdict that was not accepted. */
const back = ({plan, gone, notice}) => {
  if (notice?.kind === "other") return "decided";
  if (gone) return "none";
  return plan.refused ? "unfit" : "open";
};

const OPEN = ["none", "unfit", "open", "pressing", "sending", "waiting", "decided"];
const SENT = ["sending", "waiting"];

/**
 * The table. Of several rows for a state and an event the first whose guard holds applies; an event that no row names changes
 * nothing. States:
 *   offline   not connected: nothing is known, nothing can be sent
 *   none      no plan is under review
 *   unfit     a plan came that is not what its hash says: it is not shown, and can only be rejected
 *   open      a plan is under review; `blocked` says whether it can be approved
 *   pressing  the approve button is held, or, with `override`, the one beside what the rehearsal says
 *   sending   the verdict was given to the broker, which has not answered
 *   waiting   the broker has taken it, and the executor has not answered
 *   decided   a verdict on this plan was accepted: ours or another's
 */
export const TABLE = [
  {states: ["offline"], event: "connected", next: "none"},
  {states: SENT, event: "disconnected", action: leaveUnknown, next: "offline"},
  {states: ["pressing"], event: "disconnected", action: leavePressing, next: "offline"},
  {states: OPEN, event: "disconnected", action: leave, next: "offline"},

  {states: ["unfit", "open", "pressing", ...SENT, "decided"], event: "plan", guard: isSame, action: keepPlan},
  {states: ["pressing"], event: "plan", guard: isGone, action: cancelWith(dropPlan, "plan"), next: "none"},
  {states: SENT, event: "plan", guard: isGone, action: losePlan},
  {states: OPEN, event: "plan", guard: isGone, action: dropPlan, next: "none"},
  {states: ["pressing"], event: "plan", guard: isUsable, action: cancelWith(takePlan, "plan"), next: "open"},
  {states: SENT, event: "plan", guard: isUsable, action: takeFurther, next: "open"},
  {states: SENT, event: "plan", guard: isUnfit, action: takeFurther, next: "unfit"},
  {states: OPEN, event: "plan", guard: isUsable, action: takePlan, next: "open"},
  {states: OPEN, event: "plan", guard: isUnfit, action: takePlan, next: "unfit"},

  {states: ["pressing"], event: "view", guard: (machine, {plan}) => plan !== undefined && plan !== machine.plan.id,
    action: cancelWith(see, "view"), next: "open"},
  {states: ["pressing"], event: "view", guard: saysOther, action: cancelWith(see, "rehearsal"), next: "open"},
  {states: ["pressing"], event: "view", guard: ({override}, {obstacle = ""}) => !override && obstacle !== "",
    action: cancelWith(see, "obstacle"), next: "open"},
  {states: OPEN, event: "view", action: see},
  {states: ["pressing"], event: "rehearsal", guard: isOther, action: cancel("rehearsal"), next: "open"},
  {states: ["pressing"], event: "old", action: cancelWith(blind, "old"), next: "open"},
  {states: OPEN, event: "old", action: blind},
  {states: ["pressing"], event: "shows", guard: (machine, {what}) => what !== "", action: cancelWith(hide, "hidden"), next: "open"},
  {states: ["offline", ...OPEN], event: "shows", action: hide},
  {states: ["open", "pressing"], event: "looked", action: grow},

  {states: ["open"], event: "press", guard: mayPress, action: press, next: "pressing"},
  {states: ["pressing"], event: "tick", guard: isHeld, action: approve, next: "sending"},
  {states: ["pressing"], event: "tick", guard: stood, action: cancel("stood"), next: "open"},
  {states: ["pressing"], event: "tick", action: note},
  {states: ["pressing"], event: "release", action: cancel("early"), next: "open"},
  {states: ["open"], event: "reject", guard: hasReason, action: reject, next: "sending"},
  {states: ["unfit"], event: "reject", guard: hasReason, action: reject, next: "sending"},

  {states: ["sending"], event: "taken", action: wait, next: "waiting"},
  {states: ["sending"], event: "failed", action: fail, next: back},
  {states: ["waiting"], event: "tick", guard: isLate, action: giveUp, next: back},

  {states: SENT, event: "ack", guard: isOwnTaken, action: win, next: "decided"},
  {states: SENT, event: "ack", guard: isOwnRefused, action: lose, next: back},
  {states: SENT, event: "ack", guard: isOthers, action: yieldTo},
  {states: SENT, event: "ack", guard: isUnread, action: lose, next: back},
  {states: ["unfit", "open"], event: "ack", guard: isLateTaken, action: win, next: "decided"},
  {states: ["none"], event: "ack", guard: isLateTaken, action: win},
  {states: ["none", "unfit", "open"], event: "ack", guard: isLateRefused, action: noteLateRefusal},
  {states: ["unfit", "open", "pressing"], event: "ack", guard: isOthers, action: yieldTo, next: "decided"},
];

/**
 * Take an event.
 *
 * @returns {{machine: object, publish: object|null}} the machine afterwards; what shall be published now, if anything,
 *   on `review` or, where `sent.override` says so, on `override_rehearsal`
 */
export function step(machine, event) {
  const row = TABLE.find(({states, event: name, guard}) => name === event.type && states.includes(machine.state)
    && (guard === undefined || guard(machine, event)));
  if (row === undefined) return {machine, publish: null};
  const {publish = null, ...changes} = row.action?.(machine, event) ?? {};
  const changed = {...machine, ...changes};
  const state = typeof row.next === "function" ? row.next(changed) : row.next ?? machine.state;
  return {machine: {...changed, state, ...(state === "none" ? {plan: null, gone: false} : {})}, publish};
}
