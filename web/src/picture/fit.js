/**
 * Where a camera stands from which everything can be seen, as near as can be. Pure; points are [x, y, z] in metres.
 *
 * The picture's edges may be covered by buttons and words: `inset` says how much of it, as fractions of its width and height.
 */

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => {
  const length = Math.hypot(...a);
  return a.map((value) => value / length);
};
export const NO_INSET = {left: 0, right: 0, top: 0, bottom: 0};

/**
 * Along one side of the picture: `at` [m] of each point, `deep` [m] towards the camera, `low` and `high` slopes between which they must
 * be seen. Returns how far away the camera must be, and between which places it may stand when it is `distance` away.
 */
function side(points, at, deep, low, high) {
  const above = Math.max(...points.map((point) => dot(point, at) + high * dot(point, deep)));
  const below = Math.min(...points.map((point) => dot(point, at) + low * dot(point, deep)));
  return {
    nearest: (above - below) / (high - low),
    place: (distance) => (above - high * distance + below - low * distance) / 2,
  };
}

/**
 * Return the nearest place of a camera that sees all points.
 *
 * @param {number[][]} points at least one
 * @param {number[]} direction towards the camera; not upright
 * @param {number} fov of the picture's height [deg]
 * @param {number} aspect its width by its height
 * @param {number} [nearest] least distance from the middle of the points [m]
 * @returns {{position: number[], target: number[]}} the target is in the middle of the picture, as deep as the points' middle
 */
export function fit(points, direction, fov, aspect, inset = NO_INSET, nearest = 0.3) {
  const back = unit(direction);
  const right = unit(cross([0, 0, 1], back));
  const up = cross(back, right);
  const high = Math.tan(fov * Math.PI / 360);
  const wide = high * aspect;
  const across = side(points, right, back, (2 * inset.left - 1) * wide, (1 - 2 * inset.right) * wide);
  const upright = side(points, up, back, (2 * inset.bottom - 1) * high, (1 - 2 * inset.top) * high);
  const depths = points.map((point) => dot(point, back));
  const middle = (Math.min(...depths) + Math.max(...depths)) / 2;
  const distance = Math.max(across.nearest, upright.nearest, middle + nearest);
  const x = across.place(distance);
  const y = upright.place(distance);
  const at = (depth) => [0, 1, 2].map((k) => x * right[k] + y * up[k] + depth * back[k]);
  return {position: at(distance), target: at(middle)};
}

/** Return the points with those that are farther from the base than `most` [m] brought to that distance, each coordinate by itself. */
export function clipped(points, most) {
  return points.map((point) => point.map((value) => Math.min(most, Math.max(-most, value))));
}

/** Return the corners of a box. */
export function corners(low, high) {
  return [0, 1, 2, 3, 4, 5, 6, 7].map((k) => [0, 1, 2].map((axis) => (k >> axis & 1 ? high : low)[axis]));
}

/**
 * Return a ring of points that the arm gets to on all sides, so that its motion stays in the picture.
 *
 * @param {number} reach of the arm [m]
 * @param {number} share of it that is shown on all sides, whatever the arm does
 */
export function around(reach, share = 0.55) {
  const points = [];
  for (let k = 0; k < 12; k += 1) points.push([share * reach * Math.cos(k * Math.PI / 6), share * reach * Math.sin(k * Math.PI / 6), 0]);
  return points;
}
