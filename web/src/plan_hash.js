/**
 * Whether a plan is the one that its hash names: an approval is sent with that hash, so it must cover what the page
 * shows.
 *
 * `trajectory` (times [s], positions, velocities, accelerations; rows are waypoints) is covered by the SHA-256 of the
 * joints' names and all these numbers as 8-byte floats, little-endian. Of a work plan the hash is that of the text
 * `content`, which names the trajectory's hash and all that happens at the ends of its segments. docs/reference/mqtt.md
 * and docs/broker.md say the same.
 */
const encoder = new TextEncoder();

async function sha256(bytes) {
  const digest = await globalThis.crypto.subtle.digest("SHA-256", bytes);
  return Array.from(new Uint8Array(digest), (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** Return the SHA-256 of a trajectory, in hexadecimal. */
export function trajectoryHash(names, trajectory) {
  const head = encoder.encode(`${names.join("\0")}\0\0`);
  const rows = [trajectory.positions, trajectory.velocities, trajectory.accelerations];
  const count = trajectory.times.length * (1 + 3 * names.length);
  const bytes = new Uint8Array(head.length + 8 * count);
  bytes.set(head);
  const view = new DataView(bytes.buffer);
  let at = head.length;
  const write = (value) => {
    view.setFloat64(at, value, true);
    at += 8;
  };
  trajectory.times.forEach(write);
  for (const matrix of rows) for (const row of matrix) row.forEach(write);
  return sha256(bytes);
}

const isNumbers = (row, length) => Array.isArray(row) && row.length === length && row.every((value) => Number.isFinite(value));

function isTrajectory(trajectory, joints) {
  if (typeof trajectory !== "object" || trajectory === null || !Array.isArray(trajectory.times)) return false;
  const length = trajectory.times.length;
  return length > 0 && isNumbers(trajectory.times, length)
    && ["positions", "velocities", "accelerations"].every((key) => Array.isArray(trajectory[key])
      && trajectory[key].length === length && trajectory[key].every((row) => isNumbers(row, joints)));
}

/**
 * Return the plan with `refused`: "" when all that the hash covers is here and fits, else a short word why not. Of a
 * work plan `covered` is what stands in `content`: task and segments with all their switches; show these. `task`,
 * `duration` and `goal` become those that it covers: what the message says beside them may be anything.
 *
 * Words: `content` (the text is not what the hash says), `trajectory` (the waypoints are not), `missing` (waypoints
 * were not sent, so what would be shown is not what is approved), `insecure` (this browser hashes only on HTTPS or on
 * its own machine).
 */
export async function checkPlan(plan) {
  if (globalThis.crypto?.subtle === undefined) return {...plan, refused: "insecure"};
  let expected = plan.hash;
  let segments = null;
  if (plan.content) {
    if (typeof plan.content !== "string" || await sha256(encoder.encode(plan.content)) !== plan.hash) {
      return {...plan, refused: "content"};
    }
    const content = JSON.parse(plan.content);
    expected = content.trajectory;
    segments = content.segments;
    plan = {...plan, task: content.task, covered: content};
    // shown are the segments of the text: those beside it are not covered
    if (!sameSegments(plan.segments, segments)) return {...plan, refused: "content"};
  } else if (Array.isArray(plan.segments) && plan.segments.length) {
    return {...plan, refused: "content"};
  }
  if (plan.trajectory === undefined || plan.trajectory === null) return {...plan, refused: "missing"};
  if (!isTrajectory(plan.trajectory, plan.joints.length)) return {...plan, refused: "trajectory"};
  const found = await trajectoryHash(plan.joints, plan.trajectory);
  if (found !== expected) return {...plan, refused: "trajectory"};
  const {times, positions} = plan.trajectory;
  return {...plan, duration: times[times.length - 1], goal: positions[positions.length - 1], refused: ""};
}

function sameSegments(shown, covered) {
  if (!Array.isArray(shown) || !Array.isArray(covered) || shown.length !== covered.length) return false;
  return shown.every((segment, k) => ["name", "end", "engaged", "scene", "scene_after"].every((key) => segment[key] === covered[k][key]));
}
