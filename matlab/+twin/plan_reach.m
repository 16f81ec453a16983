function [t, q, qd, qdd] = plan_reach(robot, start, goal, obstacles, duration, count)
%PLAN_REACH  Plan a reach with manipulatorRRT and time it, at rest at every corner.
%
%   [t, q, qd, qdd] = twin.plan_reach(robot, start, goal, obstacles, duration, count)
%
%   start, goal  1-by-n [rad]
%   obstacles    cell array of collisionBox, collisionCylinder, ... in the robot's base; {} for none
%
%   What is found here is a proposal: the twin's planner checks it against its own scene, ranges and limits, at every 4 ms.
  rrt = manipulatorRRT(robot, obstacles);
  rrt.SkippedSelfCollisions = 'parent';
  path = plan(rrt, start, goal);
  if isempty(path)
    error('twin:plan_reach', 'no path was found; move the goal, or raise rrt.MaxIterations');
  end
  path = shorten(rrt, path, 50);
  [t, q, qd, qdd] = twin.rest_to_rest(path, duration, count);
end
