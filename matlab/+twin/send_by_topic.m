function [succeeded, sentence] = send_by_topic(namespace, recorder, joints, t, q, qd, qdd, patience)
%SEND_BY_TOPIC  Send a motion on joint_trajectory, and wait for the person's verdict and the end of the motion.
%
%   [succeeded, sentence] = twin.send_by_topic(namespace, recorder, joints, t, q, qd, qdd, patience)
%
%   recorder  twin.Recorder of twin/joint_states: the motion is seen there
%   patience  longest wait [s]; a person decides, so give minutes
%
%   Standard messages only. What became of the request is read from /rosout (rosgraph_msgs/Log), where the planner says it. The topic
%   plan_outcome says it too, in a message type of construction_twin: rosgenmsg makes it known to MATLAB.
  namespace = char(namespace);
  said = rossubscriber('/rosout', 'rosgraph_msgs/Log', 'BufferSize', 500, 'DataFormat', 'struct');
  publisher = rospublisher([namespace '/joint_trajectory'], 'trajectory_msgs/JointTrajectory', 'DataFormat', 'struct');
  message = rosmessage(publisher);
  blank = rosmessage('trajectory_msgs/JointTrajectoryPoint', 'DataFormat', 'struct');
  message = twin.fill_trajectory(message, blank, joints, t, q, qd, qdd);
  started = tic;
  while publisher.NumSubscribers == 0
    if toc(started) > 20
      succeeded = false;
      sentence = [namespace '/planner does not listen; is bringup running, and can its PC reach this one?'];
      return
    end
    pause(0.05);
  end
  said.NewMessageFcn = @(~, log) keep_answer(log, [namespace '/planner']);
  pause(1);  % /rosout comes from every node by itself: what the planner says before it is connected is lost
  stamps = recorder.table();
  since = stamps(end);  % /rosout is latched: what was said before is not about this request. Both stamps are of the twin's PC
  answer = '';
  send(publisher, message);
  goal = q(end, :);
  while toc(started) < patience
    pause(0.1);  % callbacks run meanwhile
    if strncmp(answer, 'no plan', 7)
      succeeded = false;
      sentence = answer;
      return
    end
    if max(abs(recorder.newest(1) - goal)) < 1e-4
      succeeded = true;
      sentence = 'the twin is at the goal';
      return
    end
  end
  succeeded = false;
  sentence = sprintf('not at the goal within %g s; the planner said: %s', patience, answer);

  function keep_answer(log, name)
    if twin.stamp(log.Header) > since && strcmp(log.Name, name) && (strncmp(log.Msg, 'no plan', 7) || strncmp(log.Msg, 'plan ', 5))
      answer = log.Msg;
      disp(answer);
    end
  end
end
