/** The tool's path of the plan that is played: what is travelled of it, and what is still ahead. Pure. */
import {progressOf} from "../progress.js";

/**
 * Return a path in two: its points up to where the tool is at a time of the plan, and from there on. Both have that
 * place, between two points; a part of no length is empty.
 *
 * @param {{times: number[], tool_path: number[][]}} path [s], [m]
 * @param {number} seconds of the plan
 * @returns {{travelled: number[][], ahead: number[][]}}
 */
export function splitPath({times, tool_path: points}, seconds) {
  const next = times.findIndex((time) => time > seconds);
  if (next === 0 || points.length < 2) return {travelled: [], ahead: points.length < 2 ? [] : points};
  if (next < 0) return {travelled: points, ahead: []};
  const part = (seconds - times[next - 1]) / (times[next] - times[next - 1]);
  if (part === 0 && next === 1) return {travelled: [], ahead: points};
  const here = points[next - 1].map((value, axis) => value + part * (points[next][axis] - value));
  const before = part === 0 ? points.slice(0, next - 1) : points.slice(0, next);
  return {travelled: [...before, here], ahead: [here, ...points.slice(next)]};
}

/**
 * Return what is drawn of the path of a robot's motion: `travelled` and `ahead` of `splitPath`, `end` of the whole
 * path, and `remaining` [s] of progress.js; null while no plan is under way, or its path is not known.
 *
 * @param {object | null} robot of the store
 */
export function playedOf(robot) {
  const {path = null, view = null} = robot ?? {};
  const now = progressOf(view?.execution ?? null);
  if (now === null || path === null || path.plan_id !== now.id || path.tool_path.length < 2) return null;
  const seconds = now.progress * view.execution.duration;
  return {...splitPath(path, seconds), end: path.tool_path.at(-1), remaining: now.remaining};
}
