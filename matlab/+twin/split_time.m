function [sec, nsec] = split_time(seconds)
%SPLIT_TIME  Seconds as a ROS duration has them: whole seconds and nanoseconds, both int32.
  nanoseconds = round(seconds * 1e9);
  whole = floor(nanoseconds / 1e9);
  sec = int32(whole);
  nsec = int32(nanoseconds - whole * 1e9);
end
