/**
 * What the simulated arm found when it carried out the plan under review: one line; opened, a bar per axis and what else was found.
 *
 * Shows only: whether a plan may be approved without it is the executor's to say, and stands in `approval_obstacle`.
 */
import {add, clear, setText} from "../dom.js";

/** What a person at the arm calls a joint, as core/axis_name.py says it in sentences: A3 for joint_a3. */
const axisName = (joint) => /^joint_([ae][1-9])$/.exec(joint)?.[1].toUpperCase() ?? joint;
const percentOf = (fraction) => (100 * fraction).toFixed(0);
const usage = ({peak, limit}) => (limit > 0 ? peak / limit : 0);

/** Return the rehearsal that is of this plan; null: there is none, or it is of another one. */
export function rehearsalOf(plan, rehearsal) {
  if (!plan || !rehearsal) return null;
  return rehearsal.plan_id === plan.id && rehearsal.plan_hash === plan.hash ? rehearsal : null;
}

/** Return the one line: how it ended, and the axis that uses the largest fraction of its torque. */
export function headline(rehearsal, texts) {
  const known = rehearsal.axes.filter(({limit}) => limit > 0);
  if (rehearsal.state !== "passed") return texts(rehearsal.state === "failed" ? "verdict.rehearsal.line.failed" : "verdict.rehearsal.line.broken");
  if (known.length === 0) return texts("verdict.rehearsal.line.passed");
  const worst = known.reduce((most, axis) => (usage(axis) > usage(most) ? axis : most));
  return texts("verdict.rehearsal.line.largest", {percent: percentOf(usage(worst)), joint: axisName(worst.joint)});
}

/** Return what else was found, one sentence each. */
export function findings({payload, braking, grip, contacts, objects, remarks, axes, engine}, texts) {
  const found = [];
  if (axes.length > 0) {
    const mass = `${payload.mass.toFixed(1)}${payload.estimated ? "~" : ""}`;
    found.push(payload.rated_mass > 0 ? texts("verdict.rehearsal.found.rated", {mass, rated: payload.rated_mass.toFixed(1)}) : texts("verdict.rehearsal.found.payload", {mass}));
    if (braking.seconds > 0) {
      found.push(texts("verdict.rehearsal.found.braking", {
        time: braking.time.toFixed(1), distance: (1000 * braking.distance).toFixed(0), percent: percentOf(braking.usage),
      }));
    }
    if (grip.name !== "") found.push(texts("verdict.rehearsal.found.grip", {cups: grip.cups, percent: percentOf(grip.usage), time: grip.time.toFixed(1)}));
  }
  for (const {first, second, time} of contacts) found.push(texts("verdict.rehearsal.found.contact", {first, second, time: time.toFixed(1)}));
  for (const {name, moved} of objects) found.push(texts("verdict.rehearsal.found.object", {name, distance: (1000 * moved).toFixed(0)}));
  for (const remark of remarks) found.push(texts.reason(remark));
  if (engine) found.push(texts("verdict.rehearsal.found.engine", {engine}));
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
      add(item, "span", {text: axis.limit > 0 ? texts("verdict.rehearsal.axis", {...values, limit, percent: percentOf(usage(axis))})
        : texts("verdict.rehearsal.axis_unknown", values)});
      const bar = add(item, "span", {className: "rehearsal-bar", "aria-hidden": "true"});
      bar.style.setProperty("--used", Math.min(1, usage(axis)).toFixed(3));
    }
    for (const text of findings(rehearsal, texts)) add(others, "li", {text});
  };
}
