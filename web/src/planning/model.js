/** What the page reads of a robot's model: its joints with their limits, and where its tool is. */
import {ends, forward} from "./chain.js";
import {limits} from "./joints.js";

async function fetchFile(path) {
  const answer = await fetch(path);
  if (!answer.ok) throw new Error(`${path}: ${answer.status}`);
  return answer.text();
}

/** How a model is fetched and read; tests give others. */
export const MEANS = {fetchText: fetchFile, parse: (text) => new DOMParser().parseFromString(text, "text/xml")};

/**
 * Return {joints, pose, base, tip}: the joints as `limits` has them; `pose` from joint values {name: value} to the pose of the link
 * `tip` in `base`. An Error says what is wrong with the file, or that there is none.
 *
 * @param {string} robot
 * @param {string[]} names of its joints, as `view` has them
 */
export async function readModel(robot, names, {fetchText, parse} = MEANS) {
  const model = parse(await fetchText(`private/${encodeURIComponent(robot)}/robot.urdf`));
  const joints = limits(model, names);
  const {base, tip} = ends(model, joints.at(-1).name);
  return {joints, base, tip, pose: forward(model, base, tip)};
}

/** Return names without what all of them begin with, up to a _: a1, a2 of joint_a1, joint_a2. One name alone stays as it is. */
export function shortNames(names) {
  if (names.length < 2) return [...names];
  let common = names[0].lastIndexOf("_") + 1;
  while (common > 0 && !names.every((name) => name.startsWith(names[0].slice(0, common)))) {
    common = names[0].lastIndexOf("_", common - 2) + 1;
  }
  return names.map((name) => name.slice(common));
}
