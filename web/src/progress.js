/** How far the plan that is played has come. Pure. */

/** States of the executor in which a plan is under way. */
const UNDER_WAY = ["PLAYING", "STOPPING", "PAUSING", "PAUSED", "HELD", "AT_BOUNDARY"];

/**
 * Return what is known of the plan that is played, null when none is: `id`; `progress` 0 to 1; `left`, seconds of the
 * plan that are still to come; `remaining`, seconds that they take at the speed that it goes to, null while it does not
 * go on; `speed` and `limit`, fractions of the planned speed, null: not known; `segment` {number from 0, name} or null.
 */
export function progressOf(execution) {
  if (!execution || !UNDER_WAY.includes(execution.state)) return null;
  const {plan_id: id, progress, duration, rate, speed_limit: limit, segment = null, state} = execution;
  const left = (1 - progress) * duration;
  // while it starts or its limit changes, it goes to the limit within a moment: the present rate would promise hours
  const goesTo = state === "PLAYING" ? Math.min(1, limit ?? rate ?? 0) : 0;
  return {id, progress, left, remaining: goesTo > 0 ? left / goesTo : null, speed: rate, limit, segment};
}

/** Return seconds as people read them: 0:07, 1:23. */
export function clock(seconds) {
  const whole = Math.ceil(seconds - 1e-6);
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}`;
}

/** Return a fraction in whole percent. What moves is not told as 0, what is not over is not told as 100. */
export function percentOf(fraction) {
  const percent = Math.round(100 * fraction);
  return fraction > 0 && percent === 0 ? 1 : fraction < 1 && percent === 100 ? 99 : percent;
}
