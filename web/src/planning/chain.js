// Where the tool is at given joint values: forward kinematics of a URDF, in metres and radians. Pure, double precision.
//
// A pose is {position: [x, y, z], quaternion: [x, y, z, w]}.

const IDENTITY = {position: [0, 0, 0], quaternion: [0, 0, 0, 1]};

// Return a function from joint values {name: value} to the pose of the link `tip` in the link `base`; joints that are not given
// stand at 0. An Error when no chain of joints leads from one to the other.
export function forward(document, base, tip) {
  const joints = [...document.getElementsByTagName("joint")].filter((joint) => joint.hasAttribute("type"));
  const byChild = new Map(joints.map((joint) => [linkOf(joint, "child"), joint]));
  const steps = [];
  for (let link = tip; link !== base; link = linkOf(byChild.get(link), "parent")) {
    if (!byChild.has(link) || steps.length > joints.length) throw new Error(`the robot's model leads from ${tip} not to ${base}`);
    steps.unshift(step(byChild.get(link)));
  }
  return (values) =>
    steps.reduce((pose, {name, origin, axis, type}) => {
      const value = values[name] ?? 0;
      return compose(compose(pose, origin), motion(type, axis, value));
    }, IDENTITY);
}

// The links between which plans are made, {base, tip}: the model's root, and `tool0`, with the prefix that a model may have; where
// it has none, the last link of the chain behind the joint `last`.
export function ends(document, last) {
  const joints = [...document.getElementsByTagName("joint")].filter((joint) => joint.hasAttribute("type"));
  const children = new Set(joints.map((joint) => linkOf(joint, "child")));
  const links = [...document.getElementsByTagName("link")].map((link) => link.getAttribute("name")).filter((name) => name !== null);
  const roots = links.filter((name) => !children.has(name));
  if (roots.length !== 1) throw new Error(`the robot's model has ${roots.length} roots`);
  const tool = links.find((name) => name === "tool0") ?? links.find((name) => name.endsWith("tool0"));
  return {base: roots[0], tip: tool ?? leaf(joints, last)};
}

function leaf(joints, last) {
  let joint = joints.find((one) => one.getAttribute("name") === last);
  if (joint === undefined) throw new Error(`the robot's model has no joint ${last}`);
  for (let left = joints.length; left > 0; left -= 1) {
    const link = linkOf(joint, "child");
    const next = joints.find((one) => linkOf(one, "parent") === link);
    if (next === undefined) return link;
    joint = next;
  }
  throw new Error("the robot's model goes round in a circle");
}

function linkOf(joint, which) {
  return joint.getElementsByTagName(which)[0].getAttribute("link");
}

function step(joint) {
  const origin = joint.getElementsByTagName("origin")[0];
  const axis = joint.getElementsByTagName("axis")[0];
  return {
    name: joint.getAttribute("name"),
    type: joint.getAttribute("type"),
    origin: {position: numbers(origin, "xyz", [0, 0, 0]), quaternion: ofAngles(numbers(origin, "rpy", [0, 0, 0]))},
    axis: unit(numbers(axis, "xyz", [1, 0, 0])),
  };
}

function numbers(element, name, otherwise) {
  const text = element ? element.getAttribute(name) : null;
  return text === null ? otherwise : text.trim().split(/\s+/).map(Number);
}

function unit(vector) {
  const length = Math.hypot(...vector);
  return vector.map((value) => value / length);
}

// URDF's roll, pitch, yaw: about the fixed axes x, y, z in this order.
function ofAngles([roll, pitch, yaw]) {
  const about = (axis, angle) => turn(axis, angle);
  return multiply(about([0, 0, 1], yaw), multiply(about([0, 1, 0], pitch), about([1, 0, 0], roll)));
}

function turn(axis, angle) {
  const sine = Math.sin(angle / 2);
  return [axis[0] * sine, axis[1] * sine, axis[2] * sine, Math.cos(angle / 2)];
}

function motion(type, axis, value) {
  if (type === "revolute" || type === "continuous") return {position: [0, 0, 0], quaternion: turn(axis, value)};
  if (type === "prismatic") return {position: axis.map((part) => part * value), quaternion: [0, 0, 0, 1]};
  return IDENTITY;
}

function multiply([ax, ay, az, aw], [bx, by, bz, bw]) {
  return [
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
    aw * bw - ax * bx - ay * by - az * bz,
  ];
}

function rotate([x, y, z, w], [px, py, pz]) {
  const tx = 2 * (y * pz - z * py);
  const ty = 2 * (z * px - x * pz);
  const tz = 2 * (x * py - y * px);
  return [px + w * tx + y * tz - z * ty, py + w * ty + z * tx - x * tz, pz + w * tz + x * ty - y * tx];
}

function compose(first, second) {
  const moved = rotate(first.quaternion, second.position);
  return {
    position: first.position.map((value, axis) => value + moved[axis]),
    quaternion: multiply(first.quaternion, second.quaternion),
  };
}
