function trajectory = fill_trajectory(trajectory, blank, joints, t, q, qd, qdd)
%FILL_TRAJECTORY  Put a motion into a trajectory_msgs/JointTrajectory structure.
%
%   trajectory = twin.fill_trajectory(trajectory, blank, joints, t, q, qd, qdd)
%
%   trajectory  as rosmessage makes it, "DataFormat" "struct"
%   blank       rosmessage("trajectory_msgs/JointTrajectoryPoint", "DataFormat", "struct")
%   joints      cell array of joint names, in the order of the columns
%   t           [s]; all 0: the planner times the path, as fast as its default speed allows
%   q, qd, qdd  [rad, rad/s, rad/s^2]; qd and qdd may be []
%
%   The stamp stays 0. It is ignored in any case: clocks of two PCs differ.
  if size(q, 2) ~= numel(joints) || size(q, 1) ~= numel(t)
    error('twin:fill_trajectory', 'positions are %d-by-%d; expected %d times and %d joints', size(q, 1), size(q, 2), numel(t), ...
          numel(joints));
  end
  points = repmat(blank, numel(t), 1);
  for k = 1:numel(t)
    points(k).Positions = q(k, :)';
    if ~isempty(qd)
      points(k).Velocities = qd(k, :)';
    end
    if ~isempty(qdd)
      points(k).Accelerations = qdd(k, :)';
    end
    [sec, nsec] = twin.split_time(t(k));
    points(k).TimeFromStart.Sec = sec;
    points(k).TimeFromStart.Nsec = nsec;
  end
  trajectory.JointNames = joints(:);
  trajectory.Points = points;
end
