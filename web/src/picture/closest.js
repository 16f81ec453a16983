/** Which closest point is drawn. Pure; metres, in base_link. */

const isPoint = (value) => Array.isArray(value) && value.length === 3 && value.every(Number.isFinite);

/**
 * Return the closest point that is drawn of a robot, as {distance, between, point, time, ofPlan}; null: none.
 *
 * While a plan is under review it is the plan's: the smallest distance on its way, `time` [s] after its start, whatever
 * the arm does meanwhile. Else, and beside a plan whose hash does not fit, it is the twin's now.
 */
export function closestOf(robot) {
  const view = robot?.view ?? null;
  const plan = robot?.plan?.refused === "" ? robot.plan : null;
  const found = plan?.clearance ?? (plan === null ? view?.closest : null) ?? null;
  if (found === null || !Number.isFinite(found.distance) || !isPoint(found.point) || found.between.length !== 2) return null;
  const {distance, between, point} = found;
  return {distance, between, point, time: plan === null ? null : found.time, ofPlan: plan !== null};
}

/** Return a distance in whole millimetres, for a person. */
export function millimetres(distance) {
  return (1000 * distance).toFixed(0);
}
