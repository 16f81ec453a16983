/** The waypoints of a plan as a table that a person can read. Pure. */
import {valueOf} from "./axes.js";
import {unit} from "./joints.js";

/** Most rows: what one looks through. */
export const MOST = 16;

/**
 * Return {names, units, rows, step, all} of a plan whose hash was checked: rows of texts, time [s] first, then the
 * joints [deg, mm]; of `all` waypoints every `step`-th is there, and the last one.
 *
 * @param {string[]} types of its joints: revolute, prismatic
 */
export function waypointsOf(plan, types) {
  const {times, positions} = plan.trajectory;
  const joints = plan.joints.map((name, k) => ({name, type: types[k]}));
  const last = times.length - 1;
  const step = Math.max(1, Math.ceil(last / (MOST - 1)));
  const picked = times.map((_, at) => at).filter((at) => at % step === 0 || at === last);
  const rows = picked.map((at) => [times[at].toFixed(2), ...joints.map((joint, k) => valueOf(joint, positions[at][k]))]);
  return {names: plan.joints, units: joints.map(unit), rows, step, all: times.length};
}
