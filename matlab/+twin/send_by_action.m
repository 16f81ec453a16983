function [succeeded, sentence] = send_by_action(namespace, joints, t, q, qd, qdd, patience)
%SEND_BY_ACTION  Send a motion as a goal of follow_joint_trajectory, and wait for the person's verdict and the end of the motion.
%
%   [succeeded, sentence] = twin.send_by_action(namespace, joints, t, q, qd, qdd, patience)
%
%   patience  longest wait [s]; a person decides, so give minutes. When it is over the goal is cancelled: an arm that moves brakes on
%             its path.
%
%   control_msgs/FollowJointTrajectory: `rosmsg list` shows whether this MATLAB knows it; otherwise twin.send_by_topic.
  client = rosactionclient([char(namespace) '/follow_joint_trajectory'], 'control_msgs/FollowJointTrajectory', 'DataFormat', 'struct');
  waitForServer(client);
  client.FeedbackFcn = [];
  goal = rosmessage(client);
  blank = rosmessage('trajectory_msgs/JointTrajectoryPoint', 'DataFormat', 'struct');
  goal.Trajectory = twin.fill_trajectory(goal.Trajectory, blank, joints, t, q, qd, qdd);
  fprintf('sent; nothing moves before a person approves: rosrun construction_twin twin approve\n');
  [result, state] = sendGoalAndWait(client, goal, patience);
  succeeded = strcmp(state, 'succeeded');
  if isempty(result)
    cancelGoal(client);
    sentence = sprintf('no result within %g s (%s); cancelled', patience, state);
  else
    sentence = result.ErrorString;
  end
end
