% The paper's reaching task, planned in MATLAB, approved by a person, executed by the digital twin and the arm beside it.
%
% Before: on the twin's PC `roslaunch construction_twin bringup.launch`. Here: set the four values below, and run the script from this
% folder. It needs ROS Toolbox and Robotics System Toolbox (R2022b or later). docs/tutorials/matlab.md explains every step.

master = 'http://192.168.1.5:11311';   % ROS_MASTER_URI of the twin's PC
host = '192.168.1.6';                  % this PC, as the twin's PC reaches it
namespace = '/kr120';
patience = 600;                        % longest wait for approval and motion [s]

goal = deg2rad([55 -50 75 40 60 -70]); % the goal of config/experiment.yaml
duration = 75.2;                       % the paper's 18,802 samples at 250 Hz [s]
count = 1500;                          % the paper's number of waypoints

[robot, joints, linear] = twin.connect(master, namespace, host);
most = round(250 * (duration + patience));
virtual = twin.Recorder([namespace '/twin/joint_states'], joints, most);
physical = twin.Recorder([namespace '/physical/joint_states'], joints, most);

start = virtual.newest(20);
[t, q, qd, qdd] = twin.plan_reach(robot, start, goal, {}, duration, count);
twin.plot_figure8(robot, q);
twin.write_csv('reaching_task.csv', joints, linear, t, q, qd, qdd);

known = rosmsg('list');
if any(strcmp(known, 'control_msgs/FollowJointTrajectoryGoal'))
  [succeeded, sentence] = twin.send_by_action(namespace, joints, t, q, qd, qdd, patience);
else
  [succeeded, sentence] = twin.send_by_topic(namespace, virtual, joints, t, q, qd, qdd, patience);
end
disp(sentence);
pause(1);                              % the arm is a few hundredths of a second behind the twin
virtual.stop();
physical.stop();

if succeeded
  [virtual_t, virtual_q] = virtual.table();
  [physical_t, physical_q] = physical.table();
  result = twin.compare_arms(virtual_t, virtual_q, physical_t, physical_q);
  twin.plot_figure9(result, joints);
  fprintf('%d samples of the twin, %d of the arm; the arm is %.0f ms behind\n', virtual.Count, physical.Count, 1000 * result.lag);
  disp(table(joints(:), result.average(:), result.maximum(:), 'VariableNames', {'joint', 'average_rad', 'maximum_rad'}));
end
rosshutdown
