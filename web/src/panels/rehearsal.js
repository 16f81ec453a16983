/**
 * What the simulated arm found when it carried out the plan under review: one line; opened, a bar per axis and what
 * else was found. And the button by which a person approves in spite of that, where a rehearsal is required.
 *
 * Whether a plan may be approved without it is the executor's to say: the view's `overridable` says that only the
 * rehearsal is against it. When the button may be pressed is verdict_state.js.
 */
import {add, clear, setText} from "../dom.js";
import {onHold} from "../press.js";
import {mark} from "../texts.js";
import {BLOCKED, makeReason} from "./reason.js";

/** Reasons of an override to pick from. */
const REASONS = [
  mark("a limit or a mass is only an estimate"), mark("the contact is meant, or is none"), mark("checked in another way"),
  mark("the rehearsal does not work at the moment"),
];

/** What a person at the arm calls a joint, as core/units.py says it in sentences: A3 for joint_a3. */
const axisName = (joint) => /^joint_([ae][1-9])$/.exec(joint)?.[1].toUpperCase() ?? joint;
const percentOf = (fraction) => (100 * fraction).toFixed(0);
const usage = ({peak, limit}) => (limit > 0 ? peak / limit : 0);

/**
 * Return the rehearsal that counts for this plan, as the executor compares it (execution/rehearsal_check.py): the
 * plan's hash covers neither the scene that it begins in nor the tool. null: there is none, or it is of something else.
 */
export function rehearsalOf(plan, rehearsal) {
  if (!plan || !rehearsal) return null;
  const {plan_id: id, plan_hash: hash, scene, tool} = rehearsal;
  return id === plan.id && hash === plan.hash && scene === plan.scene && tool === (plan.tool ?? "") ? rehearsal : null;
}

/** Return the one line: how it ended, and the axis that uses the largest fraction of its torque. */
function headline(rehearsal, texts) {
  const known = rehearsal.axes.filter(({limit}) => limit > 0);
  if (rehearsal.state !== "passed") return rehearsal.state === "failed" ? texts("Rehearsed: failed") : texts("The rehearsal broke off");
  if (known.length === 0) return texts("Rehearsed: passed");
  const worst = known.reduce((most, axis) => (usage(axis) > usage(most) ? axis : most));
  return texts("Rehearsed: passed, largest torque {percent} % ({joint})", {percent: percentOf(usage(worst)), joint: axisName(worst.joint)});
}

/** Return what else was found, one sentence each. */
function findings({payload, braking, grip, contacts, objects, remarks, axes, energy, engine}, texts) {
  const found = [];
  if (axes.length > 0) {
    const mass = `${payload.mass.toFixed(1)}${payload.estimated ? "~" : ""}`;
    found.push(payload.rated_mass > 0 ? texts("The flange carries {mass} kg of {rated} kg", {mass, rated: payload.rated_mass.toFixed(1)})
      : texts("The flange carries {mass} kg", {mass}));
    if (braking.seconds > 0) {
      found.push(texts("A stop after {time} s takes {distance} mm and {percent} % of an axis' torque", {
        time: braking.time.toFixed(1), distance: (1000 * braking.distance).toFixed(0), percent: percentOf(braking.usage),
      }));
    }
    if (grip.name !== "") {
      found.push(texts("{cups} cups hold it, the one that is loaded most with {percent} % of what it can, at {time} s",
        {cups: grip.cups, percent: percentOf(grip.usage), time: grip.time.toFixed(1)}));
    }
  }
  for (const {first, second, time} of contacts) found.push(texts("{first} touches {second} after {time} s", {first, second, time: time.toFixed(1)}));
  for (const {name, moved} of objects) found.push(texts("{name} moves {distance} mm", {name, distance: (1000 * moved).toFixed(0)}));
  for (const remark of remarks) found.push(texts.reason(remark));
  if (energy !== null) found.push(texts("The drives put in {energy} kJ", {energy: (energy / 1000).toFixed(2)}));
  if (engine) found.push(texts("Simulated by {engine}; ~ marks an estimate", {engine}));
  return found;
}

/** Make the part of a panel; the function that is returned shows a rehearsal, or hides the part for null. */
export function make(parent, texts) {
  const part = add(parent, "details", {className: "rehearsal", hidden: true});
  const line = add(part, "summary");
  const why = add(parent, "ul", {className: "rehearsal-why", hidden: true});
  const bars = add(part, "ul", {className: "rehearsal-axes"});
  const others = add(part, "ul", {className: "rehearsal-found"});
  let shown = "";
  return (rehearsal) => {
    part.hidden = rehearsal === null;
    why.hidden = rehearsal === null || rehearsal.reasons.length === 0;
    const key = rehearsal === null ? "" : `${rehearsal.plan_id}\n${rehearsal.hash}`;
    if (key === shown) return;
    shown = key;
    for (const list of [why, bars, others]) clear(list);
    part.removeAttribute("open");
    if (rehearsal === null) return;
    setText(line, headline(rehearsal, texts));
    line.className = rehearsal.state === "passed" ? "is-good" : "is-bad";
    for (const reason of rehearsal.reasons) add(why, "li", {text: texts.reason(reason)});
    for (const axis of rehearsal.axes) {
      const item = add(bars, "li", {className: usage(axis) > 1 ? "is-bad" : ""});
      const values = {joint: axisName(axis.joint), peak: axis.peak.toFixed(0), gravity: percentOf(axis.gravity)};
      const limit = `${axis.limit.toFixed(0)}${axis.estimated ? "~" : ""}`;
      add(item, "span", {text: axis.limit > 0 ? texts("{joint}: {peak} of {limit} Nm, {percent} %; holding still takes {gravity} % of that", {...values, limit, percent: percentOf(usage(axis))})
        : texts("{joint}: {peak} Nm, limit not known; holding still takes {gravity} % of that", values)});
      const bar = add(item, "span", {className: "rehearsal-bar", "aria-hidden": "true"});
      bar.style.setProperty("--used", Math.min(1, usage(axis)).toFixed(3));
    }
    for (const text of findings(rehearsal, texts)) add(others, "li", {text});
  };
}

/**
 * Make the part with which a person approves in spite of the rehearsal.
 *
 * @returns `reason()`, `clear()` and `show({open, why, held})`: whether it is offered at all, why not now ("": it can
 *   be pressed), and for which part of the second it has been held (null: it is not)
 */
export function makeOverride(parent, texts, {press, release, changed}) {
  const part = add(parent, "fieldset", {className: "override", hidden: true});
  add(part, "legend", {text: texts("Approve in spite of the rehearsal")});
  const reason = makeReason(part, texts, REASONS, changed);
  const approve = add(part, "button", {type: "button", className: "hold override-approve", "aria-describedby": "override-hint", disabled: true});
  add(approve, "span", {className: "hold-fill", "aria-hidden": "true"});
  const words = add(approve, "span", {className: "hold-text"});
  const hint = add(part, "p", {id: "override-hint", className: "override-hint"});
  onHold(approve, () => {
    if (!approve.disabled) press();
  }, release);
  return {
    reason: reason.said,
    clear: reason.clear,
    show({open, why, held}) {
      part.hidden = !open;
      reason.disable(held !== null);
      const missing = why === "" && reason.said() === "" ? "reason" : why;
      approve.disabled = !open || missing !== "";
      approve.classList.toggle("is-pressing", held !== null);
      approve.style.setProperty("--held", (held ?? 0).toFixed(3));
      setText(words, held === null ? texts("Approve all the same: hold for 1 s") : texts("Keep holding ..."));
      setText(hint, missing === "" ? texts("Your account and what you say go on record. The arm moves as soon as this is approved; "
        + "letting go earlier cancels.")
        : missing === "reason" ? texts("Say why, then the plan can be approved in spite of its rehearsal.") : texts(BLOCKED[missing]));
    },
  };
}
