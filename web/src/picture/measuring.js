/** Measuring between two points that a person taps: values in, values out. Points are [x, y, z] in metres, in base_link of a robot. */

/** Nothing is measured. */
export const NOTHING = {robot: "", points: []};

/** Return what is measured after a tap: the first point, the second, or the first of another measurement. */
export function tapped({robot, points}, whose, point) {
  return whose !== robot || points.length !== 1 ? {robot: whose, points: [point]} : {robot, points: [points[0], point]};
}

/** Return what was measured, {distance, along: [x, y, z]} [m]; null before the second tap. */
export function measured({points}) {
  if (points.length < 2) return null;
  const along = points[1].map((value, k) => value - points[0][k]);
  return {distance: Math.hypot(...along), along};
}

/** Return where a ray meets the floor; null where it does not, or farther away than `most` [m]. */
export function onFloor(origin, direction, height, most) {
  const way = (height - origin[2]) / direction[2];
  if (!(way > 0) || way > most) return null;
  return [0, 1, 2].map((k) => origin[k] + way * direction[k]);
}

/** Ways of the cross by a key [px]; with Shift a single one. */
const WAYS = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1]};
const STEP = 12;

/** Return where the cross is after a key, within the picture; null for a key that does not move it. */
export function moved([x, y], key, fine, width, height) {
  if (!Object.hasOwn(WAYS, key)) return null;
  const step = fine ? 1 : STEP;
  const within = (value, most) => Math.min(most, Math.max(0, value));
  return [within(x + step * WAYS[key][0], width), within(y + step * WAYS[key][1], height)];
}
