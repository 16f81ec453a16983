/** What the page reads of a robot's model: its joints with their limits, and where its tool is. */
import {Quaternion, Vector3} from "three";
import {parseRobot, toolOf} from "../picture/robot_model.js";

async function fetchFile(path) {
  const answer = await fetch(path);
  if (!answer.ok) throw new Error(`${path}: ${answer.status}`);
  return answer.text();
}

/** Return a joint of a model as {name, type, lower, upper} [rad, m]. */
function jointOf(robot, name) {
  const found = robot.joints[name];
  if (found === undefined) throw new Error(`the robot's model has no joint ${name}`);
  if (found.jointType === "continuous") return {name, type: "revolute", lower: -Math.PI, upper: Math.PI};
  const {lower, upper} = found.limit;
  if (!(lower < upper)) throw new Error(`joint ${name} of the robot's model has no limits`);
  return {name, type: found.jointType === "prismatic" ? "prismatic" : "revolute", lower, upper};
}

/**
 * Return {joints, base, tip, pose} of a URDF: the joints in the order of `names`; `pose` from joint values {name:
 * value} to the pose {position, quaternion} of the link `tip` in `base`, joints that are not given at 0. An Error says
 * what the file lacks.
 */
export function modelOf(text, names) {
  const {robot} = parseRobot(text, "", {parseVisual: false});
  const joints = names.map((name) => jointOf(robot, name));
  const tool = toolOf(robot);
  const pose = (values) => {
    for (const [name, joint] of Object.entries(robot.joints)) joint.setJointValue(values[name] ?? 0);
    const [position, quaternion] = [new Vector3(), new Quaternion()];
    tool.updateWorldMatrix(true, false);
    tool.matrixWorld.decompose(position, quaternion, new Vector3());
    return {position: position.toArray(), quaternion: quaternion.toArray()};
  };
  return {joints, base: robot.name, tip: tool.name, pose};
}

/**
 * Read the model of each robot that is heard, and tell it as `model`: what `modelOf` returns, or {trouble}, why there
 * is none, which is tried again with the next connection.
 */
export function readModels(store, connection, fetchText = fetchFile) {
  const asked = new Map();
  store.on("view", async (robot, view) => {
    const names = view?.joints.names ?? [];
    const key = names.join("\n");
    if (view === null || connection.state !== "connected" || asked.get(robot) === key) return;
    asked.set(robot, key);
    let model;
    try {
      model = modelOf(await fetchText(`private/${encodeURIComponent(robot)}/robot.urdf`), names);
    } catch (error) {
      model = {trouble: error.message};
    }
    if (asked.get(robot) === key) store.set("model", robot, model);
  });
  store.on("connection", () => {
    for (const robot of asked.keys()) if (store.robot(robot).model?.trouble) asked.delete(robot);
  });
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
