function planner = manipulatorRRT(robot, obstacles)
  planner = struct('Robot', robot, 'Obstacles', {obstacles}, 'SkippedSelfCollisions', 'adjacent');
end
