function q = solve_pose(robot, pose, seed)
%SOLVE_POSE  Joint positions that bring tool0 to a pose, near a seed.
%
%   q = twin.solve_pose(robot, pose, seed)
%
%   pose  4-by-4 homogeneous transform in the robot's base [m], e.g. trvec2tform([1.3 -0.3 1.4]) * eul2tform([pi 0 pi])
%   seed  1-by-n, e.g. where the arm is
  ik = inverseKinematics('RigidBodyTree', robot);
  [q, info] = ik('tool0', pose, [1 1 1 1 1 1], seed);
  if ~strcmp(info.Status, 'success')
    error('twin:solve_pose', 'the pose was not reached (%s, error %g); choose another pose or seed', info.Status, info.PoseErrorNorm);
  end
end
