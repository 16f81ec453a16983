function [t, q, qd, qdd] = rest_to_rest(corners, duration, count)
%REST_TO_REST  Waypoints along straight lines in joint space, at rest at every corner.
%
%   [t, q, qd, qdd] = twin.rest_to_rest(corners, duration, count)
%
%   corners   m-by-n: joint positions, one row per corner [rad], prismatic joints [m]
%   duration  of the whole motion [s]; each line gets a part of it that is proportional to its length
%   count     number of waypoints, at least 2
%
%   t count-by-1 [s], q, qd, qdd count-by-n [rad, rad/s, rad/s^2]. Each line is the quintic that quinticpolytraj makes with its default
%   boundary conditions: velocity and acceleration are zero at both ends. The planner's limits of jerk are kept, which a trapezoidal
%   velocity (trapveltraj) cannot. Needs no toolbox.
  if size(corners, 1) < 2 || count < 2 || ~(duration > 0)
    error('twin:rest_to_rest', 'expected two corners, two waypoints and a duration above 0; got %d, %d and %g s', ...
          size(corners, 1), count, duration);
  end
  steps = diff(corners, 1, 1);
  lengths = sqrt(sum(steps .^ 2, 2));
  steps = steps(lengths > 0, :);
  corners = [corners(1, :); corners(1, :) + cumsum(steps, 1)];
  lengths = lengths(lengths > 0);
  if isempty(lengths)
    error('twin:rest_to_rest', 'all corners are the same pose; a motion needs another one');
  end
  ends = [0; cumsum(lengths)] / sum(lengths) * duration;
  ends(end) = duration;
  t = linspace(0, duration, count)';
  t = round(t * 1e9) / 1e9;  % a ROS duration has whole nanoseconds
  q = zeros(count, size(corners, 2));
  qd = q;
  qdd = q;
  for k = 1:count
    line = find(t(k) >= ends(1:end - 1), 1, 'last');
    T = ends(line + 1) - ends(line);
    s = min(max((t(k) - ends(line)) / T, 0), 1);
    q(k, :) = corners(line, :) + (10 * s^3 - 15 * s^4 + 6 * s^5) * steps(line, :);
    qd(k, :) = (30 * s^2 - 60 * s^3 + 30 * s^4) / T * steps(line, :);
    qdd(k, :) = (60 * s - 180 * s^2 + 120 * s^3) / T^2 * steps(line, :);
  end
  qd([1, end], :) = 0;
  qdd([1, end], :) = 0;
end
