function result = compare_arms(twin_t, twin_q, arm_t, arm_q)
%COMPARE_ARMS  The numbers of the paper's Figure 9 and Table 1 for two recordings.
%
%   result = twin.compare_arms(twin_t, twin_q, arm_t, arm_q)
%
%   twin_t, arm_t  stamps [s], on one clock: both are stamped on the PC of the digital twin
%   twin_q, arm_q  positions, one row per stamp [rad]
%
%   result.t, .twin, .arm   both arms at the twin's stamps, from the first one on
%   result.lag              constant time by which the arm is behind [s], to 1 ms
%   result.average, .maximum        absolute error per joint with that lag taken out [rad]
%   result.average_instant, .maximum_instant   the same at equal stamps
  longest = 0.3;
  inside = twin_t >= arm_t(1) & twin_t <= arm_t(end) - longest;
  t = twin_t(inside);
  if numel(t) < 2
    error('twin:compare_arms', 'the recordings overlap by less than %g s; record both arms at the same time', longest);
  end
  twin_inside = twin_q(inside, :);
  [arm_t, first] = unique(arm_t);
  arm_q = arm_q(first, :);
  lags = 0:0.001:longest;
  squares = zeros(size(lags));
  for k = 1:numel(lags)
    difference = interp1(arm_t, arm_q, t + lags(k)) - twin_inside;
    squares(k) = mean(difference(:) .^ 2);
  end
  [~, best] = min(squares);
  instant = abs(interp1(arm_t, arm_q, t) - twin_inside);
  behind = abs(interp1(arm_t, arm_q, t + lags(best)) - twin_inside);
  result.t = t - t(1);
  result.twin = twin_inside;
  result.arm = interp1(arm_t, arm_q, t);
  result.lag = lags(best);
  result.average = mean(behind, 1);
  result.maximum = max(behind, [], 1);
  result.average_instant = mean(instant, 1);
  result.maximum_instant = max(instant, [], 1);
end
