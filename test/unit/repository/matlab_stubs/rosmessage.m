function message = rosmessage(kind, varargin)
% Blank structures of the types that matlab/ asks for, with the fields of the documentation ("DataFormat" "struct").
  header = struct('Seq', uint32(0), 'Stamp', struct('Sec', uint32(0), 'Nsec', uint32(0)), 'FrameId', '');
  trajectory = struct('MessageType', 'trajectory_msgs/JointTrajectory', 'Header', header, 'JointNames', {{}}, 'Points', []);
  if isstruct(kind)
    if strcmp(kind.Kind, 'action')
      message = struct('MessageType', 'control_msgs/FollowJointTrajectoryGoal', 'Trajectory', trajectory, 'PathTolerance', [], ...
                       'GoalTolerance', [], 'GoalTimeTolerance', struct('Sec', int32(0), 'Nsec', int32(0)));
    else
      message = trajectory;
    end
  elseif strcmp(kind, 'trajectory_msgs/JointTrajectoryPoint')
    message = struct('MessageType', kind, 'Positions', zeros(0, 1), 'Velocities', zeros(0, 1), 'Accelerations', zeros(0, 1), ...
                     'Effort', zeros(0, 1), 'TimeFromStart', struct('Sec', int32(0), 'Nsec', int32(0)));
  else
    error('no stub of %s', kind);
  end
end
