/**
 * Where the arm is, always: each joint within its limits, twin and arm, and by how much they differ; where the arm's
 * servos should have it, while somebody knows that; the twin's tool; operating mode and override of the controller.
 * Limits and tool come from the robot's model. Shown ten times a second at most, and while it is open.
 */
import {add, addDrawing, clear, setText} from "../dom.js";
import {axesOf} from "../planning/axes.js";
import {shown} from "../planning/joints.js";
import {shortNames} from "../planning/model.js";
import {mark} from "../texts.js";
import {browser} from "./clock.js";
import {FIELDS, textsOf} from "./tool_fields.js";

const EVERY = 100;
const UNKNOWN = "–";
const COLUMNS = {
  joint: mark("Joint"), range: mark("Range"), twin: mark("Twin"), arm: mark("Measured"), expected: mark("Expected"),
  difference: mark("Difference"),
};
const VALUES = Object.keys(COLUMNS).slice(2);
/** Marks on a joint's bar, the uppermost last. */
const MARKS = ["arm", "twin", "expected"];
/** The curve has the largest value of each step [ms], and so many steps: a minute. */
const STEP = 500;
const STEPS = 120;

/** Return the largest difference of twin and arm as a part of what the gate allows; null: not known. */
export function deviationOf({online, sync}) {
  const parts = online && sync ? sync.error.map((error, k) => Math.abs(error) / sync.threshold[k]).filter(Number.isFinite) : [];
  return parts.length ? Math.max(...parts) : null;
}

/** Return what is kept of one robot's deviations, [[step, largest], ...], with one more. */
function withDeviation(kept, at, value) {
  const step = Math.floor(at / STEP);
  const last = kept.at(-1);
  const added = last?.[0] === step ? [...kept.slice(0, -1), [step, Math.max(last[1], value)]] : [...kept, [step, value]];
  return added.filter(([each]) => each > step - STEPS);
}

export function make(parent, store, connection, texts, {now, every} = browser) {
  const deviations = new Map();
  // it scrolls, and has nothing else in it that a keyboard reaches
  parent.setAttribute("tabindex", "0");
  const area = add(parent, "div", {className: "motion"});
  const facts = add(area, "dl", {className: "motion-facts"});
  const factOf = (text) => {
    const group = add(facts, "div");
    add(group, "dt", {text});
    return add(group, "dd", {text: UNKNOWN});
  };
  const mode = factOf(texts("Operating mode"));
  const override = factOf(texts("Override"));
  const apart = factOf(texts("Tool: twin to arm"));
  const trip = factOf(texts("Round trip to the arm"));
  const late = factOf(texts("Late replies"));
  const curve = add(area, "figure", {className: "motion-curve"});
  const curveText = add(curve, "figcaption");
  const drawing = addDrawing(curve, "svg", {viewBox: `0 0 ${STEPS} 1`, preserveAspectRatio: "none", "aria-hidden": "true"});
  const bound = addDrawing(drawing, "path");
  const line = addDrawing(drawing, "polyline");
  const table = add(area, "div", {className: "motion-axes", role: "table", "aria-label": texts("Joints, twin and arm")});
  const key = add(area, "p", {className: "motion-key"});
  for (const name of ["twin", "arm", "expected"]) {
    add(key, "span", {className: `motion-mark motion-${name}`, "aria-hidden": "true"});
    add(key, "span", {className: `motion-${name}-name`, text: texts(COLUMNS[name])});
  }
  const note = add(key, "span", {className: "motion-note"});
  const tool = add(area, "div", {className: "motion-tool"});
  const toolName = add(tool, "p", {className: "motion-tool-name"});
  const toolList = add(tool, "dl");
  const toolFields = Object.values(FIELDS).map((name) => {
    const group = add(toolList, "div");
    add(group, "dt", {text: texts(name)});
    return add(group, "dd", {text: UNKNOWN});
  });
  let rows = [];
  let shownNames = "";
  let dirty = true;

  // -- what is shown

  const build = (view) => {
    clear(table);
    rows = [];
    const head = add(table, "div", {className: "motion-row motion-head", role: "row"});
    for (const [column, words] of Object.entries(COLUMNS)) {
      add(head, "span", {role: "columnheader", className: `motion-${column}`, text: texts(words)});
    }
    const short = shortNames(view.joints.names);
    view.joints.names.forEach((name, k) => {
      const row = add(table, "div", {className: "motion-row", role: "row"});
      add(row, "span", {role: "rowheader", className: "motion-joint", text: short[k], title: name});
      const range = add(row, "span", {role: "cell", className: "motion-range"});
      const lower = add(range, "span", {className: "motion-end"});
      const bar = add(range, "span", {className: "motion-bar", "aria-hidden": "true"});
      const marks = MARKS.map((what) => add(bar, "span", {className: `motion-at motion-at-${what}`, hidden: true}));
      const upper = add(range, "span", {className: "motion-end"});
      const cells = VALUES.map((column) => add(row, "span", {role: "cell", className: `motion-${column}`}));
      rows.push({row, lower, upper, marks, cells, at: MARKS.map(() => null)});
    });
  };

  const showRow = ({row, lower, upper, marks, cells, at}, axis) => {
    const {joint, unit, twin, arm, expected, difference, allowed, isOver} = axis;
    const hasLimits = joint.lower < joint.upper;
    setText(lower, hasLimits ? shown(joint, joint.lower).toFixed(0) : "");
    setText(upper, hasLimits ? shown(joint, joint.upper).toFixed(0) : "");
    const withUnit = (text) => (text === "" ? UNKNOWN : unit === "°" ? `${text}°` : `${text} ${unit}`);
    const [found, bound] = [difference, allowed].map(withUnit);
    const compared = difference === "" || allowed === "" ? found
      : isOver ? texts("{difference} over {allowed}", {difference: found, allowed: bound})
        : texts("{difference} of {allowed}", {difference: found, allowed: bound});
    [withUnit(twin), withUnit(arm), withUnit(expected), compared].forEach((text, k) => setText(cells[k], text));
    row.classList.toggle("is-over", isOver);
    MARKS.map((what) => axis.at[what]).forEach((value, k) => {
      marks[k].hidden = value === null;
      const percent = value === null ? null : (100 * value).toFixed(1);
      if (percent !== at[k] && percent !== null) marks[k].style.setProperty("--at", percent);
      at[k] = percent;
    });
  };

  const showTool = (view, model) => {
    tool.hidden = model === null;
    const of = (pose) => (model === null || !pose ? null : model.pose(Object.fromEntries(view.joints.names.map((name, k) => [name, pose.positions[k]]))));
    const [twin, arm] = [of(view.twin), of(view.arm)];
    if (model !== null) setText(toolName, texts("Tool of the twin: {tip} in {base}", {tip: model.tip, base: model.base}));
    const values = twin === null ? [] : textsOf(twin);
    toolFields.forEach((field, k) => setText(field, values[k] === undefined ? UNKNOWN : k < 3 ? `${values[k]} mm` : `${values[k]}°`));
    const distance = twin === null || arm === null ? null : Math.hypot(...twin.position.map((value, k) => value - arm.position[k]));
    setText(apart, distance === null ? UNKNOWN : `${(1000 * distance).toFixed(1)} mm`);
  };

  /** Draw the last minute; where nothing was known the line goes straight on. */
  const showCurve = (robot) => {
    const kept = deviations.get(robot) ?? [];
    const newest = Math.floor(now() / STEP);
    const top = 1.1 * Math.max(1, ...kept.map(([, value]) => value));
    bound.setAttribute("d", `M0 ${1 - 1 / top}H${STEPS}`);
    line.setAttribute("points", kept.map(([step, value]) => `${STEPS - 1 - newest + step},${(1 - value / top).toFixed(3)}`).join(" "));
    const percent = (value) => (value === undefined ? UNKNOWN : `${(100 * value).toFixed(0)} %`);
    const [last] = kept.slice(-1).filter(([step]) => newest - step < 3);
    const most = kept.length ? Math.max(...kept.map(([, value]) => value)) : undefined;
    setText(curveText, texts("Largest difference, last minute: {now} now, {most} at most (100 %: all that is allowed)",
      {now: percent(last?.[1]), most: percent(most)}));
  };

  const show = () => {
    dirty = false;
    const robot = store.robot(store.selected);
    const view = robot?.view ?? null;
    area.hidden = view === null;
    if (view === null) return;
    const names = `${robot.name}\n${view.joints.names.join("\n")}`;
    if (names !== shownNames) build(view);
    shownNames = names;
    // without a model of the servos nobody ever expects anything: no place is taken for it
    area.classList.toggle("has-expected", (view.expected ?? null) !== null);
    const model = robot.model?.joints ? robot.model : null;
    axesOf(view, model?.joints ?? null).forEach((axis, k) => showRow(rows[k], axis));
    showTool(view, model);
    showCurve(robot.name);
    const why = robot.model?.trouble;
    setText(note, why ? texts("Limits and tool are not known: the robot's model could not be read ({why}).", {why}) : "");
    const told = (value, unit = "") => {
      if (view.link === null) return texts("not known");
      return value === "" || value === null || value === undefined ? texts("not sent") : `${value}${unit}`;
    };
    setText(mode, told(view.link?.controller?.mode));
    setText(override, told(view.link?.controller?.override_percent, " %"));
    setText(trip, told(view.link?.round_trip_ms?.toFixed(1), " ms"));
    setText(late, told(view.link?.late));
  };

  const isOpen = () => (parent.tab?.isOpen() ?? true) && parent.ownerDocument.visibilityState !== "hidden";
  parent.tab?.onOpen(show);
  store.on("view", (robot, view) => {
    if (robot === store.selected) dirty = true;
    const deviation = view === null ? null : deviationOf(view);
    if (deviation !== null) deviations.set(robot, withDeviation(deviations.get(robot) ?? [], now(), deviation));
  });
  for (const kind of ["selected", "connection", "model"]) store.on(kind, show);
  every(EVERY, () => {
    if (dirty && isOpen()) show();
  });
  show();
}
