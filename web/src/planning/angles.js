/** Orientations as KUKA's controllers show them: A about Z, then B about the new Y, then C about the newest X (Z-Y'-X''), in degrees. Pure. */

const DEGREES = 180 / Math.PI;
/** Sine of B from which on A and C turn about the same axis: then C is 0. */
const UPRIGHT = 1 - 1e-8;

/** Return {a, b, c} [deg] of a quaternion x y z w; a and c lie from -180 to 180, b from -90 to 90. */
export function toAngles([x, y, z, w]) {
  const sine = 2 * (w * y - z * x);
  if (Math.abs(sine) > UPRIGHT) {
    const turn = 2 * Math.atan2(z, w) * DEGREES;
    return {a: wrapped(turn), b: 90 * Math.sign(sine), c: 0};
  }
  return {
    a: Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) * DEGREES,
    b: Math.asin(sine) * DEGREES,
    c: Math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)) * DEGREES,
  };
}

/** Return the quaternion x y z w of {a, b, c} [deg]. */
export function fromAngles({a, b, c}) {
  const [sa, sb, sc] = [a, b, c].map((angle) => Math.sin(angle / DEGREES / 2));
  const [ca, cb, cc] = [a, b, c].map((angle) => Math.cos(angle / DEGREES / 2));
  return [
    ca * cb * sc - sa * sb * cc,
    ca * sb * cc + sa * cb * sc,
    sa * cb * cc - ca * sb * sc,
    ca * cb * cc + sa * sb * sc,
  ];
}

/** Return an angle [deg] as people read it; what rounds to 0 has no sign, and half a turn is +180. */
export function shownAngle(angle) {
  const text = angle.toFixed(2);
  return Number(text) === 0 || text === "-180.00" ? text.replace("-", "") : text;
}

function wrapped(angle) {
  return angle > 180 ? angle - 360 : angle <= -180 ? angle + 360 : angle;
}
