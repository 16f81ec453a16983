/**
 * Colours of what is drawn; the same as in rviz (views/sync_picture.py, views/work_markers.py). Words come from the
 * broker: a table has its own keys and no others.
 */

/** Of the measured arm by the gate's state: colour and opacity. Faint while the poses agree, so that the twin is easy to see. */
export const BY_SYNC = {
  __proto__: null,
  WAITING: [0x73809a, 0.35],
  IN_SYNC: [0x1abf40, 0.2],
  HOLDING: [0xffcc00, 0.6],
  REPLANNING: [0x8c40f2, 0.55],
  STALE: [0x4073f2, 0.55],
  STOPPED: [0xe60d1a, 0.6],
  FAULT: [0xe60d1a, 0.6],
};
/** The arm while nothing is known of the gate. */
export const UNKNOWN_SYNC = [0x73809a, 0.35];

/** Of an element of the building model by the state of its task, and of one without a task. */
const PENDING = [0x999ea8, 0.25];
export const BY_TASK = {
  __proto__: null,
  waiting: PENDING, ready: [0x1a66f2, 0.4], planned: [0x1a66f2, 0.55], working: [0xf29a1a, 0.9],
  carried: [0xf29a1a, 0.9], gripping: [0xf29a1a, 0.9], carrying: [0xf29a1a, 0.9], releasing: [0xf29a1a, 0.9],
  retreating: [0xf29a1a, 0.9], asks: [0xd91f1a, 0.8], held: [0xd91f1a, 0.8], skipped: [0x594d66, 0.12], done: [0x33a64d, 1],
};
export const NO_TASK = PENDING;
export const PICKED = [0xff4fd8, 0.8];

export const PLAN = 0x2f7df6;
export const GOAL = 0x0e9aa7;
export const PATH = 0x2f7df6;
/** While a plan is played: what is still ahead of the tool is drawn as the planned path was. */
export const AHEAD = PATH;
export const TRAVELLED = 0x8696b0;
/** Of the waypoints on a path. */
export const WAYPOINT = 0xffffff;
export const PATH_ENGAGED = 0xf29a1a;
export const CLOSEST = 0xd946ef;
export const STANDING = 0xaab2be;
export const EDGE = 0x2b3440;
export const CARRIED = 0xc9a227;
/** Of a frame: x, y, z. */
export const AXES = [0xe5383b, 0x2fa84f, 0x3b82f6];
