function robot = importrobot(urdf, key, value)
  printf('importrobot %s %s %s\n', urdf, key, value);
  kinds = {'fixed', 'prismatic', 'revolute', 'fixed'};
  for k = 1:4
    robot.Bodies{k}.Joint = struct('Name', sprintf('joint_%d', k), 'Type', kinds{k});
  end
  robot.NumBodies = 4;
end
