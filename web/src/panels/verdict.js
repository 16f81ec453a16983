/**
 * The verdict on the plan under review. What may be done when is verdict_state.js; this shows it and takes the person's
 * presses.
 *
 * A verdict goes to `review/<account>`; whether this account may give one is the broker's to decide, and whether it
 * counts the executor's. Both answers are shown.
 */
import {add, clear, setText} from "../dom.js";
import {onHold} from "../press.js";
import {SAID} from "../requests.js";
import {whoCan} from "../rights.js";
import * as verdict from "../verdict_state.js";
import {browser} from "./clock.js";
import {mark} from "../texts.js";
import {segmentsOf, switched} from "./playback.js";
import {BLOCKED, makeReason} from "./reason.js";
import {make as makeRehearsal, makeOverride, rehearsalOf} from "./rehearsal.js";

const TICK_EVERY = 50;
/** Reasons of a rejection to pick from. */
const REASONS = [
  mark("too close to something"), mark("wrong goal or wrong element"), mark("the scene is not as shown"),
  mark("a person is in the cell"), mark("too fast"), mark("not now"),
];
const LONGEST_NAME = 64;
/** Words of picture/seen.js for a picture that a person cannot see: nothing is approved without it. */
const HIDDEN = ["away", "small", "lost"];
const GOOD = ["accepted"];
/** The broker's reason code for a message that nobody has subscribed to (MQTT 5.0, section 3.4.2.1). */
const NOBODY = 16;
const CHECKS = {
  duration: mark("Duration"), clearance: mark("Closest distance"), velocity: mark("Velocity"), acceleration: mark("Acceleration"),
  jerk: mark("Jerk"), planner: mark("Planned by"), source: mark("Asked for by"), task: mark("Task"), scene: mark("Scene"),
  hash: mark("Hash of what is shown"),
};
/** Words of plan_hash.js. */
const REFUSED = {
  content: mark("what came is not what its hash names."),
  trajectory: mark("its motion is not the one that its hash names."),
  missing: mark("it came without its motion, which is too long for a message. Look at it at the desk."),
  insecure: mark("this browser checks hashes only over HTTPS, or on the robot's own PC."),
};
/** Words of picture/seen.js, and where there is no picture. */
export const UNSEEN = {
  away: mark("The picture is not in view: come back to it, then the plan can be approved."),
  small: mark("The picture is too small to judge a motion: make the window larger, or show one robot alone."),
  model: mark("The robot is not drawn in the picture, so a playback shows nothing: open the plan's checks, then it can be approved."),
  lost: mark("The browser draws nothing at the moment: wait for the picture, or reload the page."),
  none: mark("There is no picture here, so a playback shows nothing: open the plan's checks, then it can be approved."),
};
const VERDICTS = {approved: mark("Approval"), rejected: mark("Rejection")};
/** What has become of a verdict: kinds of a notice of verdict_state.js, and its states on the way. */
const NOTICES = {
  sending: SAID.sending,
  waiting: mark("{what}: the broker has it, the executor has not answered yet."),
  accepted: mark("{what} accepted. {reason}"),
  refused: mark("{what} NOT accepted: {reason}"),
  expired: SAID.expired,
  other: mark("{account} was first: {what} accepted. Yours does not count. {reason}"),
  unanswered: mark("{what}: no answer from the executor. It may have counted: watch the arm, and look at the plan again. "
    + "An approval that has started nothing by now starts nothing any more."),
  unknown: mark("{what}: the connection broke or another plan came before the answer. It is not known whether it counted: watch the arm."),
};
/** Why a press became no verdict. */
const CANCELLED = {
  obstacle: mark("Not sent: meanwhile something came up against it."),
  rehearsal: mark("Not approved: what the rehearsal says has changed while the button was held."),
  early: mark("Not approved: the button was released before the second was over."),
  offline: mark("Not approved: the connection was lost while the button was held."),
  plan: mark("Not approved: another plan came, or the plan was taken away."),
  view: mark("Not approved: the robot no longer says that this plan is under review."),
  old: mark("Not approved: the arm's state was not heard while the button was held."),
  stood: mark("Not approved: this page stood still while the button was held."),
  hidden: mark("Not approved: picture or sentence could not be seen any more while you held."),
};
/** Why a verdict did not go out, or nobody has taken it: reasons of NotPublished. */
const FAILED = {
  not_connected: SAID.not_sent,
  refused: SAID.no_right,
  unanswered: mark("{what}: the broker has not answered. It may still count: watch the arm."),
  nobody: mark("{what} does NOT count: nobody takes verdicts at the moment. Somebody must look at console_node."),
};
/** Return what there is to know of a plan before it is approved: rows of a word of `CHECKS` and text. */
function checksOf(plan, texts) {
  const rows = [
    ["duration", `${plan.duration.toFixed(1)} s`],
    ["planner", plan.planner],
    ["source", plan.source],
    ...(plan.task ? [["task", plan.task]] : []),
    ["scene", plan.scene.slice(0, 12)],
    ["hash", plan.hash.slice(0, 12)],
  ];
  const {clearance, use} = plan;
  if (clearance !== null) {
    const [distance, between] = [(1000 * clearance.distance).toFixed(0), clearance.between.join(" - ")];
    rows.splice(1, 0, ["clearance", clearance.distance === null ? texts("nothing near")
      : texts("{distance} mm, {between}, at {time} s", {distance, between, time: clearance.time.toFixed(1)})]);
  } else {
    rows.splice(1, 0, ["clearance", texts("not measured")]);
  }
  for (const kind of ["jerk", "acceleration", "velocity"]) {
    const values = use[kind];
    if (values.length === 0) continue;
    const most = Math.max(...values);
    const joint = plan.joints[values.indexOf(most)];
    rows.splice(2, 0, [kind, texts("{percent} % of the limit ({joint})", {percent: (100 * most).toFixed(0), joint})]);
  }
  return rows;
}

/** Return the sentences about a work plan's segments. */
function segmentSentences(plan, texts) {
  const signals = (given) => (Array.isArray(given) ? given.map(({name, value}) => [name, value]) : Object.entries(given ?? {}))
    .map(([name, value]) => switched(name, value, texts)).join(", ");
  const parts = plan.covered?.segments ?? plan.segments ?? [];
  const ends = segmentsOf(plan);
  return parts.map((segment, k) => [
    texts("{number}. {name}, {begin} s to {end} s.", {
      number: k + 1, name: segment.name, begin: ends[k].begin.toFixed(1), end: ends[k].end.toFixed(1),
    }),
    segment.engaged ? texts("In contact: after a stop inside only the way back can be planned.") : "",
    signals(segment.requires) ? texts("Needs {signals}.", {signals: signals(segment.requires)}) : "",
    ...(segment.switches ?? []).map(({output: name, value, confirm}) => {
      const output = switched(name, value, texts);
      return signals(confirm) ? texts("At its end: {output}; goes on when {signals}.", {output, signals: signals(confirm)})
        : texts("At its end: {output}.", {output});
    }),
  ].filter(Boolean).join(" "));
}

export function make(parent, store, connection, texts, {now, every} = browser) {
  const machines = new Map();
  const none = add(parent, "p", {className: "verdict-none"});
  const other = add(parent, "p", {className: "verdict-other", hidden: true});
  const area = add(parent, "div", {className: "verdict", hidden: true});
  const title = add(area, "p", {className: "verdict-title"});
  const short = add(area, "p", {className: "verdict-short"});
  const unfit = add(area, "p", {className: "verdict-unfit", role: "alert", hidden: true});
  const checks = add(area, "details", {className: "verdict-checks"});
  add(checks, "summary", {text: texts("Checks")});
  const table = add(checks, "dl");
  const segments = add(checks, "ol", {className: "verdict-segments"});
  const showRehearsal = makeRehearsal(area, texts);
  const override = makeOverride(area, texts, {
    press: () => take(store.selected, {type: "press", override: true, reason: override.reason(), rehearsal: hashShown(store.selected)}),
    release: () => release(), changed: () => show(),
  });
  const steps = add(area, "ul", {className: "verdict-steps", "aria-label": texts("What an approval needs")});
  const stepLooked = add(steps, "li");
  const stepShown = add(steps, "li");
  const nameLabel = add(area, "label", {className: "verdict-name", hidden: true});
  add(nameLabel, "span", {text: texts("Your name")});
  const name = add(nameLabel, "input", {type: "text", maxlength: LONGEST_NAME, autocomplete: "off"});
  // stays in view however long the rest is
  const act = add(area, "div", {className: "verdict-act"});
  const approve = add(act, "button", {type: "button", className: "hold verdict-approve", "aria-describedby": "verdict-hint", disabled: true});
  add(approve, "span", {className: "hold-fill", "aria-hidden": "true"});
  const approveText = add(approve, "span", {className: "hold-text verdict-approve-text", text: texts("Approve: hold for 1 s")});
  const hint = add(act, "p", {id: "verdict-hint", className: "verdict-hint"});
  const rejection = add(area, "fieldset", {className: "verdict-rejection"});
  add(rejection, "legend", {text: texts("Reject")});
  const rejected = makeReason(rejection, texts, REASONS, () => show());
  const reject = add(rejection, "button", {type: "button", className: "verdict-reject", text: texts("Reject"), disabled: true});
  const notice = add(parent, "p", {className: "verdict-notice", role: "alert", hidden: true});
  let open = "";

  const machineOf = (robot) => machines.get(robot) ?? verdict.begin();
  const reviewer = () => connection.account || name.value.trim();
  /** Return the hash of the rehearsal that is shown of a robot's plan; "" for none. */
  const hashShown = (robot) => {
    const {plan = null, rehearsal = null} = store.robot(robot) ?? {};
    return rehearsalOf(plan, rehearsal)?.hash ?? "";
  };

  const take = (robot, event) => {
    if (robot === "") return;
    const sender = connection.own("override_rehearsal").split("/")[1];
    const given = {at: now(), reviewer: reviewer(), account: connection.account, sender, ...event};
    const before = machineOf(robot);
    let machine = before;
    // the store takes away what was heard before it tells that the connection is lost
    if (connection.state !== "connected" && machine.state !== "offline") machine = verdict.step(machine, {...given, type: "disconnected"}).machine;
    const {machine: after, publish} = verdict.step(machine, given);
    machines.set(robot, after);
    // what has to be opened again is closed
    if (robot === store.selected && before.checks && !after.checks) checks.removeAttribute("open");
    if (publish !== null) {
      connection.publish(connection.own(after.sent.override ? "override_rehearsal" : "review"), robot, {...publish, moment: store.moment(robot)}).then(
        (code) => take(robot, code === NOBODY ? {type: "failed", reason: "nobody"} : {type: "taken"}),
        (error) => take(robot, {type: "failed", reason: error.reason ?? "unanswered"}),
      );
    }
    // 25 views a second say the same
    const changed = Object.keys(after).some((key) => after[key] !== before[key]);
    if (robot === store.selected ? changed : after.state !== before.state) show();
  };

  const showPlan = (plan) => {
    const {clearance} = plan;
    const known = clearance !== null && clearance.distance !== null;
    const seconds = plan.duration.toFixed(1);
    setText(short, !known ? texts("{seconds} s; no distance was measured", {seconds})
      : texts("{seconds} s; closest distance {distance} mm", {seconds, distance: (1000 * clearance.distance).toFixed(0)}));
    clear(table);
    for (const [key, text] of checksOf(plan, texts)) {
      add(table, "dt", {text: texts(CHECKS[key])});
      add(table, "dd", {text});
    }
    clear(segments);
    for (const sentence of segmentSentences(plan, texts)) add(segments, "li", {text: sentence});
    checks.removeAttribute("open");
    rejected.clear();
    override.clear();
  };

  /** A task is named as in the list of tasks, where it is known; its id and the whole of who asks are among the checks. */
  const showTitle = (plan, tasks) => {
    const name = tasks?.tasks.find(({id}) => id === plan.task)?.name || plan.task;
    setText(title, plan.task ? texts("Plan of the task {task}", {task: name})
      : texts("Plan by {source}", {source: texts.reason(plan.source)}));
  };

  const step = (element, done, text) => {
    element.classList.toggle("is-done", done);
    setText(element, done ? texts("done: {what}", {what: text}) : texts("not yet: {what}", {what: text}));
  };

  const show = () => {
    const robot = store.selected;
    const machine = machineOf(robot);
    const found = store.robot(robot)?.plan ?? null;
    const waiting = store.robots.filter((each) => each !== robot && store.robot(each).plan !== null);
    other.hidden = waiting.length === 0;
    setText(other, waiting.length ? texts("A plan waits for review at: {robot}", {robot: waiting.join(", ")}) : "");
    area.hidden = found === null || machine.state === "offline" || machine.state === "none";
    none.hidden = !area.hidden;
    setText(none, connection.state === "connected" ? texts("No plan is under review.")
      : texts("Not connected: no plan can be shown or decided."));
    if (found !== null && !area.hidden) {
      const key = `${robot}\n${found.id}\n${found.hash}\n${found.refused}`;
      if (key !== open) showPlan(found);
      open = key;
      showTitle(found, store.robot(robot).tasks);
      unfit.hidden = found.refused === "";
      const unfitFor = texts.word(REFUSED, found.refused);
      setText(unfit, unfitFor ? texts("This plan cannot be shown and cannot be approved here: {why}", {why: unfitFor}) : "");
      checks.hidden = steps.hidden = act.hidden = found.refused !== "";
    } else {
      open = "";
    }
    showRehearsal(area.hidden ? null : rehearsalOf(found, store.robot(robot).rehearsal));
    const named = reviewer() !== "";
    const may = store.rightsOf.may(robot, "approve") !== false;
    const why = may ? verdict.blocked(machine) || (named ? "" : "name") : "right";
    const pressing = machine.state === "pressing" && !machine.override;
    showOverride(machine, named, may);
    nameLabel.hidden = connection.account !== "";
    approve.disabled = why !== "";
    approve.classList.toggle("is-pressing", pressing);
    const held = pressing ? heldFor(machine) : 0;
    approve.style.setProperty("--held", held.toFixed(3));
    setText(approveText, pressing ? texts("Keep holding ...") : texts("Approve: hold for 1 s"));
    const drawn = store.robot(robot)?.drawn ?? "none";
    const unseen = (why === "look" || why === "unseen") && drawn !== "seen";
    setText(hint, why === "" ? texts("The arm moves as soon as this is approved. Hold the button for one second; letting go earlier cancels.")
      : why === "right" ? `${texts("This account may not approve.")} ${whoCan(store.rightsOf.who(robot, "approve"), texts)}`
        : texts(unseen ? UNSEEN[drawn] : BLOCKED[why], {reason: texts.reason(machine.obstacle)}));
    step(stepLooked, machine.played || machine.checks, texts("played to its end, or checks opened"));
    step(stepShown, machine.shownFor >= verdict.SHOWN_FOR, texts("shown for a second"));
    const free = may && (machine.state === "open" || machine.state === "unfit");
    reject.disabled = !free || !named || rejected.said() === "";
    rejected.disable(!free);
    showNotice(machine);
    // what became of a press stands where it was pressed, in view as the button is; its place is the hint's, so that nothing moves
    if (area.hidden || act.hidden) area.after(notice);
    else if (notice.parentElement !== act) hint.before(notice);
    hint.hidden = why === "" && !notice.hidden && notice.parentElement === act;
  };

  const heldFor = ({pressedAt}) => Math.min(1, (now() - pressedAt) / verdict.HELD_FOR);

  /** What may be pressed in spite of the rehearsal; while that is on its way it stays where it is. */
  const showOverride = (machine, named, may) => {
    const sent = machine.sent?.override === true;
    const open = !area.hidden && may && (sent || (["open", "pressing"].includes(machine.state) && machine.overridable));
    // the other button cannot be pressed then, and on a phone it would stand before this one
    approve.hidden = open;
    override.show({
      open,
      why: sent ? "sending" : verdict.blocked(machine, true) || (named ? "" : "name"),
      held: machine.state === "pressing" && machine.override ? heldFor(machine) : null,
    });
  };

  const showNotice = ({notice: said, state, sent}) => {
    // what was said before a press is void with it; its place stays, so that the button does not move under the finger
    if (state === "pressing" && !notice.hidden) {
      notice.classList.add("is-void");
      return;
    }
    const sending = state === "sending" || state === "waiting";
    notice.hidden = said === null && !sending;
    if (notice.hidden) {
      setText(notice, "");
      return;
    }
    const what = (word) => texts(VERDICTS[word === "rejected" ? "rejected" : "approved"]);
    if (sending && said?.kind !== "other") {
      notice.className = "verdict-notice";
      setText(notice, texts(NOTICES[state], {what: what(sent.verdict)}));
      return;
    }
    notice.className = `verdict-notice ${GOOD.includes(said.kind) ? "is-good" : said.kind === "cancelled" ? "" : "is-bad"}`;
    const words = said.kind === "cancelled" ? CANCELLED[said.why] : said.kind === "failed" ? FAILED[said.reason] : NOTICES[said.kind];
    setText(notice, texts(words ?? mark("{what} was not taken by the broker."), {
      what: what(said.verdict), account: said.account || texts("somebody else"), reason: texts.reason(said.reason ?? ""),
    }));
  };

  // -- the person

  const press = () => {
    if (!approve.disabled) take(store.selected, {type: "press"});
  };
  const release = () => {
    if (machineOf(store.selected).state === "pressing") take(store.selected, {type: "release"});
  };
  onHold(approve, press, release);
  parent.ownerDocument.addEventListener("visibilitychange", release);
  reject.addEventListener("click", () => take(store.selected, {type: "reject", reason: rejected.said()}));
  for (const event of ["input", "change"]) name.addEventListener(event, show);
  checks.addEventListener("toggle", () => {
    const plan = store.robot(store.selected)?.plan ?? null;
    if (checks.hasAttribute("open") && plan !== null && plan.refused === "") take(store.selected, {type: "looked", what: "checks", hash: plan.hash});
  });

  // -- what is heard

  const planOf = (plan) => (plan === null ? null : {id: plan.id, hash: plan.hash, refused: plan.refused ?? "missing"});
  const viewOf = ({plan, approval_obstacle: obstacle, overridable, execution}) => (
    {type: "view", plan, obstacle, overridable, ended: execution?.outcome ? execution.plan_id : ""}
  );
  // no picture, or none of this robot, is no picture that is covered: then the checks are what a person looks at
  const hides = (robot) => {
    const {drawn = null, said = null} = store.robot(robot) ?? {};
    return HIDDEN.includes(drawn) ? "unseen" : said !== "whole" ? "unread" : "";
  };
  const look = (robot) => {
    // before `connect` there is no machine of it
    if (machines.has(robot) && machineOf(robot).hides !== hides(robot)) take(robot, {type: "shows", what: hides(robot)});
  };
  const connect = (robot) => {
    take(robot, {type: "connected"});
    look(robot);
    const known = store.robot(robot);
    if (known.plan !== null) take(robot, {type: "plan", plan: planOf(known.plan)});
    if (known.view !== null && !known.old) take(robot, viewOf(known.view));
  };
  store.on("robots", () => {
    for (const robot of store.robots) if (!machines.has(robot) && connection.state === "connected") connect(robot);
    show();
  });
  store.on("connection", (_, state) => {
    for (const robot of store.robots) {
      if (state === "connected") connect(robot);
      else take(robot, {type: "disconnected"});
    }
    show();
  });
  let selected = store.selected;
  store.on("selected", () => {
    if (machineOf(selected).state === "pressing") take(selected, {type: "release"});
    selected = store.selected;
    show();
  });
  store.on("plan", (robot, plan) => {
    const before = machineOf(robot).plan?.id ?? "";
    take(robot, {type: "plan", plan: planOf(plan)});
    parent.tab?.mark(store.robots.some((each) => store.robot(each).plan !== null) ? "!" : "");
    // play and approve come before the eye of whoever asked for it, and of everybody else
    if (plan !== null && plan.id !== before && robot === store.selected) parent.tab?.open();
  });
  store.on("view", (robot, view) => {
    if (view !== null) take(robot, view.online ? viewOf(view) : {type: "old"});
  });
  store.on("old", (robot, old) => {
    if (old) take(robot, {type: "old"});
  });
  for (const kind of ["drawn", "said"]) store.on(kind, look);
  store.on("rights", show);
  // before it is shown: what moves on the page then may end the press too
  store.on("rehearsal", (robot) => take(robot, {type: "rehearsal", rehearsal: hashShown(robot)}));
  for (const kind of ["tasks", "drawn", "rehearsal"]) {
    store.on(kind, (robot) => {
      if (robot === store.selected) show();
    });
  }
  store.on("looked", (robot, {what, hash}) => take(robot, {type: "looked", what, hash}));
  store.on("failed", (_, {part}) => {
    // the area takes no presses any more, and so sees no release either
    if (part === "verdict") for (const [robot, {state}] of machines) if (state === "pressing") take(robot, {type: "release"});
  });
  store.on("review_ack", (robot, ack) => take(robot, {type: "ack", ack}));
  every(TICK_EVERY, () => {
    for (const [robot, {state}] of machines) {
      if (state === "pressing" || state === "waiting") take(robot, {type: "tick"});
    }
  });
  show();
}
