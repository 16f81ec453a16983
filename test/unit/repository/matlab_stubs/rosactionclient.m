function client = rosactionclient(name, kind, key, value)
  if ~strcmp(kind, 'control_msgs/FollowJointTrajectory') || ~strcmp(key, 'DataFormat') || ~strcmp(value, 'struct')
    error('unexpected arguments');
  end
  client = struct('Kind', 'action', 'ActionName', name, 'FeedbackFcn', @disp);
end
