classdef Recorder < handle
%RECORDER  Keeps every sensor_msgs/JointState of one topic: recorder = twin.Recorder('/kr120/twin/joint_states', joints, 100000).
%
%   The third argument is the largest number of messages, at 250 Hz; later ones are counted in Lost and not kept.
%   [t, q] = recorder.table() returns stamps [s] and positions, in the order of `joints`.

  properties (SetAccess = private)
    Count = 0
    Lost = 0
  end

  properties (Access = private)
    Joints
    Order = []
    Times
    Positions
    Subscriber
  end

  methods
    function recorder = Recorder(topic, joints, most)
      recorder.Joints = joints;
      recorder.Times = zeros(most, 1);
      recorder.Positions = zeros(most, numel(joints));
      recorder.Subscriber = rossubscriber(topic, 'sensor_msgs/JointState', @(~, message) recorder.take(message), ...
                                          'BufferSize', 500, 'DataFormat', 'struct');
    end

    function [t, q] = table(recorder)
      t = recorder.Times(1:recorder.Count);
      q = recorder.Positions(1:recorder.Count, :);
    end

    function q = newest(recorder, timeout)
      started = tic;
      while recorder.Count == 0
        if toc(started) > timeout
          error('twin:Recorder', 'no message on %s within %g s; is bringup running, and can its PC reach this one?', ...
                recorder.Subscriber.TopicName, timeout);
        end
        pause(0.05);
      end
      q = recorder.Positions(recorder.Count, :);
    end

    function stop(recorder)
      recorder.Subscriber = [];
    end
  end

  methods (Access = private)
    function take(recorder, message)
      if isempty(recorder.Order)
        [found, recorder.Order] = ismember(recorder.Joints, message.Name);
        if ~all(found)
          error('twin:Recorder', 'the message lacks joints; it names %s', strjoin(message.Name, ', '));
        end
      end
      if recorder.Count == numel(recorder.Times)
        recorder.Lost = recorder.Lost + 1;
        return
      end
      recorder.Count = recorder.Count + 1;
      recorder.Times(recorder.Count) = twin.stamp(message.Header);
      recorder.Positions(recorder.Count, :) = message.Position(recorder.Order);
    end
  end
end
