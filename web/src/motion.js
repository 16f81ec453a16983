/**
 * A plan's motion at any time, and how much of it was played to a person. Draws nothing; times are seconds of the plan.
 *
 * A trajectory is that of a plan whose hash was checked (plan_hash.js): `times`, and by waypoint rows of `positions`,
 * `velocities` and `accelerations` in the order of the plan's joints [rad, m].
 */

/** Return how long a motion takes [s]. */
export function durationOf(trajectory) {
  return trajectory.times[trajectory.times.length - 1];
}

/**
 * Return the joints' positions at a time: between two waypoints the polynomial of the fifth degree that meets both, as
 * the executor plays it. Before the start and after the end the motion rests.
 */
export function sample(trajectory, seconds) {
  const {times, positions, velocities, accelerations} = trajectory;
  const last = times.length - 1;
  if (!(seconds > 0)) return [...positions[0]];
  if (seconds >= times[last]) return [...positions[last]];
  let low = 0;
  let high = last;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= seconds) low = middle;
    else high = middle;
  }
  const h = times[low + 1] - times[low];
  const u = (seconds - times[low]) / h;
  return positions[low].map((begin, joint) => {
    const step = positions[low + 1][joint] - begin;
    const v0 = velocities[low][joint] * h;
    const v1 = velocities[low + 1][joint] * h;
    const a0 = accelerations[low][joint] * h * h;
    const a1 = accelerations[low + 1][joint] * h * h;
    const c3 = 10 * step - 6 * v0 - 4 * v1 - 1.5 * a0 + 0.5 * a1;
    const c4 = -15 * step + 8 * v0 + 7 * v1 + 1.5 * a0 - a1;
    const c5 = 6 * step - 3 * (v0 + v1) - 0.5 * (a0 - a1);
    return begin + u * (v0 + u * (0.5 * a0 + u * (c3 + u * (c4 + u * c5))));
  });
}

/** Longest step of the plan's time that counts as played [s] per second of speed: a page that stood still has shown nothing. */
const LONGEST_FRAME = 0.25;

/** Return a playback that stands at the start; `seen` is how far the motion was played without a gap. */
export function rewound(duration) {
  return {duration, time: 0, speed: 1, playing: false, seen: 0};
}

/**
 * Return the playback after a frame of `elapsed` seconds. A frame that came late moves on less: nothing is left out.
 * `visible` says whether somebody could see it; else the motion goes on and does not count as seen.
 */
export function advanced(playback, elapsed, visible = true) {
  if (!playback.playing) return playback;
  const step = Math.min(Math.max(elapsed, 0), LONGEST_FRAME) * playback.speed;
  const time = Math.min(playback.time + step, playback.duration);
  const seen = visible && playback.time <= playback.seen ? Math.max(playback.seen, time) : playback.seen;
  return {...playback, time, seen, playing: time < playback.duration};
}

/** Return the playback at a time that was chosen. What was jumped over does not count as seen. */
export function sought(playback, time) {
  return {...playback, time: Math.min(Math.max(time, 0), playback.duration)};
}

/** Return the playback with play pressed or paused; at the end play begins anew. */
export function toggled(playback) {
  if (playback.playing) return {...playback, playing: false};
  return {...playback, playing: true, time: playback.time >= playback.duration ? 0 : playback.time};
}

/** Return whether all of the motion was played. */
export function wasPlayed(playback) {
  return playback.seen >= playback.duration;
}
