/** The grid on the floor: which lines, how far, and which of them have their metres beside them. Pure; metres. */

/** Lines stand at every metre; between them at every tenth where these are at least this far apart [px]. */
const FINE = 9;
/** Least distance of two numbers on the screen [px]. */
const APART = 44;
const STEPS = [1, 2, 5, 10, 20, 50];
/** The numbered part of the floor reaches at least so far on all sides of the base, and at most so far [m]. */
const LEAST = 2;
const MOST = 30;

/**
 * Return which lines are drawn, by how large a pixel is where the camera looks at [m].
 *
 * @returns {{fine: number, step: number}} `fine`: how strong the lines between the metres are, 0 to 1; `step`: every so many metres
 *   a number
 */
export function gridOf(pixel) {
  const fine = Math.min(1, Math.max(0, (0.1 / pixel - FINE) / FINE));
  const step = STEPS.find((each) => each / pixel >= APART) ?? STEPS.at(-1);
  return {fine, step};
}

/** Return the part of the floor that is numbered, [x from, y from, x to, y to]: whole metres around all points. */
export function extentOf(points) {
  const bound = (axis, sign) => {
    const far = Math.max(LEAST, ...points.map((point) => sign * point[axis]));
    return sign * Math.min(MOST, Math.ceil(far - 1e-6));
  };
  return [bound(0, -1), bound(1, -1), bound(0, 1), bound(1, 1)];
}

/**
 * Return the numbers at the edges that are farther from the camera, where all of them are in the picture: {text, x, y}.
 *
 * @param {number[]} extent of `extentOf`
 * @param {number} step of `gridOf`
 * @param {number[]} eye where the camera is
 */
export function numbersOf(extent, step, eye) {
  const [left, front, right, rear] = extent;
  const y = eye[1] < (front + rear) / 2 ? rear : front;
  const x = eye[0] < (left + right) / 2 ? right : left;
  const found = [];
  const add = (value, at) => found.push({text: `${value} m`, ...at});
  for (let value = Math.ceil(left / step) * step; value <= right; value += step) if (value !== x) add(value, {x: value, y});
  for (let value = Math.ceil(front / step) * step; value <= rear; value += step) if (value !== y) add(value, {x, y: value});
  return found;
}

/** Flat boxes at least so wide and deep are a floor [m]. */
const WIDE = 2;
/** A floor's top is at most so far above the base's foot [m]. */
const ABOVE = 0.01;

/**
 * Return the object of a scene that is the floor, and how high its top is: a box that lies flat, below the base, wide enough to stand
 * on. Null where there is none.
 *
 * @returns {{name: string, height: number} | null} the highest of several
 */
export function floorOf(objects) {
  let found = null;
  for (const {name, shape, size, position, orientation, link} of objects) {
    if (link || shape !== "box" || size.length !== 3 || Math.min(size[0], size[1]) < WIDE) continue;
    if (Math.hypot(orientation[0], orientation[1]) > 1e-3) continue;
    const height = position[2] + size[2] / 2;
    if (height <= ABOVE && (found === null || height > found.height)) found = {name, height};
  }
  return found;
}
