/** Where the plan under review comes closest to something. Pure; metres, in base_link. */

const isPoint = (value) => Array.isArray(value) && value.length === 3 && value.every(Number.isFinite);

/** Return the closest point of a robot's plan as {distance, between, point, time}, `time` [s] after its start; null: none. */
export function closestOf(robot) {
  const found = robot?.plan?.refused === "" ? robot.plan.clearance : null;
  if (!found || !Number.isFinite(found.distance) || !isPoint(found.point) || found.between.length !== 2) return null;
  const {distance, between, point, time} = found;
  return {distance, between, point, time};
}

/** Return a distance in whole millimetres, for a person. */
export function millimetres(distance) {
  return (1000 * distance).toFixed(0);
}
