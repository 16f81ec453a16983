function subscriber = rossubscriber(topic, kind, callback, varargin)
  global CALLBACK
  CALLBACK = callback;
  subscriber = struct('TopicName', topic, 'Kind', kind);
end
