/** Joint by joint: where twin, arm and what is expected of the arm are within the limits, and by how much twin and arm differ. Pure; a view's values in, degrees and mm out. */
import {shown, unit} from "./joints.js";

/** Decimals that are shown, by unit: 0.01 degrees and 0.1 mm. */
const DECIMALS = {"°": 2, mm: 1};

/** Return a joint's value [rad, m] as people read it, without its unit; "" for null. */
export function valueOf(joint, value) {
  if (value === null || value === undefined) return "";
  const text = shown(joint, value).toFixed(DECIMALS[unit(joint)]);
  // -0.00
  return Number(text) === 0 ? text.replace("-", "") : text;
}

/**
 * Return a row per joint of a view: `joint` {name, type, lower, upper}, `unit`, and as texts `twin`, `arm`, `expected`,
 * `difference`, `allowed` ("" where it is not known); `isOver` the difference is larger than the gate allows; `at`
 * {twin, arm, expected}: where in the limits, from 0 to 1, null where that or the limits are not known.
 *
 * @param {object[] | null} joints as from `limits`; null: the model is not known
 */
export function axesOf(view, joints) {
  return view.joints.names.map((name, k) => {
    const joint = joints?.find((each) => each.name === name) ?? {name, type: view.joints.types[k], lower: NaN, upper: NaN};
    const twin = view.twin?.positions[k] ?? null;
    const arm = view.arm?.positions[k] ?? null;
    const expected = view.expected?.positions[k] ?? null;
    const error = view.sync?.error[k] ?? null;
    const allowed = view.sync?.threshold[k] ?? null;
    const difference = error === null ? null : Math.abs(error);
    return {
      joint, unit: unit(joint), twin: valueOf(joint, twin), arm: valueOf(joint, arm), expected: valueOf(joint, expected), difference: valueOf(joint, difference),
      allowed: valueOf(joint, allowed), isOver: difference !== null && allowed !== null && difference > allowed,
      at: {twin: within(joint, twin), arm: within(joint, arm), expected: within(joint, expected)},
    };
  });
}

/** A joint that turns for ever may be beyond what is drawn: then its mark stands at the end. */
function within({lower, upper}, value) {
  if (value === null || !(lower < upper)) return null;
  return Math.min(1, Math.max(0, (value - lower) / (upper - lower)));
}
