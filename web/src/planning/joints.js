// The joints of a robot with their limits, from its URDF; degrees and millimetres for people, radians and metres for the rest.

const DEGREES = 180 / Math.PI;
const MILLIMETRES = 1000;

// Return the movable joints of a URDF in the order of `names` (those of `view`): [{name, type, lower, upper}], rad or m.
// document: the parsed XML. A joint that is not in it, or has no limits, raises an Error that names it.
export function limits(document, names) {
  const found = new Map();
  for (const joint of document.getElementsByTagName("joint")) {
    if (joint.hasAttribute("type")) found.set(joint.getAttribute("name"), joint);
  }
  return names.map((name) => {
    const joint = found.get(name);
    if (!joint) throw new Error(`the robot's model has no joint ${name}`);
    const type = joint.getAttribute("type");
    const limit = joint.getElementsByTagName("limit")[0];
    const [lower, upper] = ["lower", "upper"].map((end) => Number.parseFloat(limit ? limit.getAttribute(end) : ""));
    if (type === "continuous") return {name, type: "revolute", lower: -Math.PI, upper: Math.PI};
    if (!(lower < upper)) throw new Error(`joint ${name} of the robot's model has no limits`);
    return {name, type: type === "prismatic" ? "prismatic" : "revolute", lower, upper};
  });
}

export function unit(joint) {
  return joint.type === "prismatic" ? "mm" : "°";
}

export function shown(joint, value) {
  return value * (joint.type === "prismatic" ? MILLIMETRES : DEGREES);
}

export function fromShown(joint, value) {
  return value / (joint.type === "prismatic" ? MILLIMETRES : DEGREES);
}

// The ends of a slider, in tenths of a degree or whole millimetres inside the limits.
export function ends(joint) {
  const scale = joint.type === "prismatic" ? 1 : 10;
  return {
    min: Math.ceil(shown(joint, joint.lower) * scale - 1e-6) / scale,
    max: Math.floor(shown(joint, joint.upper) * scale + 1e-6) / scale,
    step: 1 / scale,
  };
}

// The value [rad, m] that a person typed, or null when it is no number or outside of the limits. A comma may stand for the point.
export function typed(joint, text) {
  const plain = text.trim().replace(",", ".").replace("−", "-");
  if (!/^[+-]?(\d+\.?\d*|\.\d+)$/.test(plain)) return null;
  const value = fromShown(joint, Number(plain));
  return isInside(joint, value) ? value : null;
}

export function isInside(joint, value) {
  return value >= joint.lower - 1e-9 && value <= joint.upper + 1e-9;
}
