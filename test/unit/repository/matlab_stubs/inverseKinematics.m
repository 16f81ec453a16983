function solver = inverseKinematics(key, robot)
  solver = @(link, pose, weights, seed) solve(robot, link, pose, weights, seed);
end

function [q, info] = solve(robot, link, pose, weights, seed)
  q = seed + pose(1, 4);
  info = struct('Status', robot.Status, 'PoseErrorNorm', 0.5);
end
