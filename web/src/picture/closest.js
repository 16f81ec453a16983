/** Which closest point is drawn, and where the other body is nearest to it. Pure; metres, in base_link. */

const isPoint = (value) => Array.isArray(value) && value.length === 3 && value.every(Number.isFinite);

/** So far may a computed distance be from the one that was measured, as a part of it, and at least [m]. */
const PART = 0.03;
const LEAST = 0.003;

/**
 * Return the closest point that is drawn of a robot, as {distance, between, point, time, ofPlan}; null: none.
 *
 * While a plan is under review it is the plan's: the smallest distance on its way, `time` [s] after its start, whatever the arm does
 * meanwhile. Else, and beside a plan whose hash does not fit, it is the twin's now.
 */
export function closestOf(robot) {
  const view = robot?.view ?? null;
  const plan = robot?.plan?.refused === "" ? robot.plan : null;
  const found = plan?.clearance ?? (plan === null ? view?.closest : null) ?? null;
  if (found === null || !Number.isFinite(found.distance) || !isPoint(found.point) || found.between.length !== 2) return null;
  const {distance, between, point} = found;
  return {distance, between, point, time: plan === null ? null : found.time, ofPlan: plan !== null};
}

/** Turn a vector by a quaternion x y z w; `sign` -1: back. */
function turned([x, y, z], [qx, qy, qz, qw], sign = 1) {
  const [a, b, c] = [sign * qx, sign * qy, sign * qz];
  const [u, v, w] = [2 * (b * z - c * y), 2 * (c * x - a * z), 2 * (a * y - b * x)];
  return [x + qw * u + b * w - c * v, y + qw * v + c * u - a * w, z + qw * w + a * v - b * u];
}

/** Return the place of a body, in its own frame, that is nearest to a point; null for a shape that is not computed. */
function nearest(shape, size, point) {
  const within = (value, half) => Math.min(half, Math.max(-half, value));
  if (shape === "box" && size.length === 3) return point.map((value, k) => within(value, size[k] / 2));
  const length = Math.hypot(...point);
  if (shape === "sphere" && size.length === 1) return length === 0 ? null : point.map((value) => value * Math.min(1, size[0] / length));
  if (shape === "cylinder" && size.length === 2) {
    const across = Math.hypot(point[0], point[1]);
    const share = across > size[0] ? size[0] / across : 1;
    return [point[0] * share, point[1] * share, within(point[2], size[1] / 2)];
  }
  return null;
}

/**
 * Return where the second body of a closest point is nearest to it; null where that is not known: the body is a link, is carried, or
 * is a mesh, or what is computed is not the distance that was measured.
 *
 * @param {object} closest of `closestOf`
 * @param {object[]} objects of the scene
 */
export function otherPoint(closest, objects) {
  const object = objects.find(({name, link}) => name === closest.between[1] && !link);
  if (object === undefined || closest.distance <= 0) return null;
  const {position, orientation} = object;
  const own = turned(closest.point.map((value, k) => value - position[k]), orientation, -1);
  const found = nearest(object.shape, object.size, own);
  if (found === null) return null;
  const distance = Math.hypot(...found.map((value, k) => value - own[k]));
  if (Math.abs(distance - closest.distance) > Math.max(LEAST, PART * closest.distance)) return null;
  return turned(found, orientation).map((value, k) => value + position[k]);
}

/** Return a distance in whole millimetres, for a person. */
export function millimetres(distance) {
  return (1000 * distance).toFixed(0);
}
