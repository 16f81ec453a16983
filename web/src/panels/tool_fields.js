/** The tool's pose as numbers, x y z in mm and A B C in degrees, for a motion or a straight line to it. */
import {add, button, setText} from "../dom.js";
import {fromAngles, shownAngle, toAngles} from "../planning/angles.js";
import {numberOf} from "../planning/joints.js";
import {mark} from "../texts.js";

export const FIELDS = {x: "X", y: "Y", z: "Z", a: mark("A (about Z)"), b: mark("B (about Y')"), c: mark("C (about X'')")};
const ASKS = {pose: mark("Ask for a motion of the tool to there"), line: mark("Ask for a straight line of the tool to there")};
/** Farthest that is sent [mm]: what is typed wrongly is told here, and what an arm does not reach the planner says. */
const FARTHEST = 100000;

/** Return the six texts of a pose {position [m], quaternion}. */
export function textsOf({position, quaternion}) {
  const {a, b, c} = toAngles(quaternion);
  const millimetres = position.map((value) => (1000 * value).toFixed(1)).map((text) => (text === "-0.0" ? "0.0" : text));
  return [...millimetres, ...[a, b, c].map(shownAngle)];
}

/**
 * Make the fields.
 *
 * @param {(kind: "pose"|"line", pose: {position: number[], quaternion: number[]}) => void} onPose a person wants the tool there
 * @returns {{show: (pose: object) => void, disable: (off: boolean) => void}} shows the goal's pose, once for each goal
 */
export function makeToolFields(parent, texts, onPose) {
  const details = add(parent, "details", {className: "plan-tool"});
  add(details, "summary", {text: texts("Goal of the tool as numbers")});
  const form = add(details, "div", {className: "plan-tool-fields", role: "group", "aria-label": texts("Goal of the tool as numbers")});
  const fields = Object.entries(FIELDS).map(([name, words]) => {
    const label = add(form, "label");
    add(label, "span", {text: texts(words)});
    const unit = "xyz".includes(name) ? "mm" : "°";
    const field = add(label, "input", {type: "text", inputmode: "text", size: 7, autocomplete: "off",
      "aria-label": `${texts(words)} [${unit}]`});
    add(label, "span", {text: unit});
    field.addEventListener("input", () => {
      field.removeAttribute("aria-invalid");
      setText(wrong, "");
    });
    return field;
  });
  const buttons = Object.entries(ASKS).map(([kind, words]) => button(form, texts(words), () => onGo(kind), {className: `plan-tool-${kind}`}));
  const wrong = add(form, "p", {className: "plan-tool-note", role: "status"});
  let last = "";

  function onGo(kind) {
    const values = fields.map((field, k) => numberOf(field.value, k < 3 ? FARTHEST : 360));
    fields.forEach((field, k) => {
      if (values[k] === null) field.setAttribute("aria-invalid", "true");
    });
    if (values.includes(null)) {
      setText(wrong, texts("Write numbers: X, Y, Z in mm, A, B, C in degrees, at most 360."));
      return;
    }
    const [x, y, z, a, b, c] = values;
    onPose(kind, {position: [x / 1000, y / 1000, z / 1000], quaternion: fromAngles({a, b, c})});
  }

  return {
    show(pose) {
      const found = textsOf(pose);
      const key = found.join(" ");
      // what is being typed stays until it is taken, or the goal becomes another one
      if (key === last) return;
      last = key;
      fields.forEach((field, k) => {
        field.value = found[k];
        field.removeAttribute("aria-invalid");
      });
      setText(wrong, "");
    },
    disable(off) {
      for (const each of buttons) each.disabled = off;
    },
  };
}
