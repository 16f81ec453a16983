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

// The number that a person typed; null when it is none, or beyond `most`. A comma may stand for the point.
export function numberOf(text, most = Infinity) {
  const plain = text.trim().replace(",", ".").replace("−", "-");
  return /^[+-]?(\d+\.?\d*|\.\d+)$/.test(plain) && Math.abs(Number(plain)) <= most ? Number(plain) : null;
}

// The value [rad, m] of a joint that a person typed, or null when it is no number or outside of the limits.
export function typed(joint, text) {
  const number = numberOf(text);
  const value = number === null ? null : fromShown(joint, number);
  return value !== null && isInside(joint, value) ? value : null;
}

export function isInside(joint, value) {
  return value >= joint.lower - 1e-9 && value <= joint.upper + 1e-9;
}
