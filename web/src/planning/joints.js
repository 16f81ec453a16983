// The joints of a robot (planning/model.js) as people read them: degrees and millimetres; radians and metres for the rest.

const DEGREES = 180 / Math.PI;
const MILLIMETRES = 1000;

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
