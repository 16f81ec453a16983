function plot_figure8(robot, q)
%PLOT_FIGURE8  The paper's Figure 8: the arm at the start and at the goal, and the path of tool0 as a pink line.
  path = zeros(size(q, 1), 3);
  for k = 1:size(q, 1)
    pose = getTransform(robot, q(k, :), 'tool0');
    path(k, :) = pose(1:3, 4)';
  end
  figure('Name', 'Figure 8');
  show(robot, q(1, :), 'Frames', 'off');
  hold on
  show(robot, q(end, :), 'Frames', 'off', 'PreservePlot', true);
  plot3(path(:, 1), path(:, 2), path(:, 3), 'Color', [1 0.25 0.64], 'LineWidth', 2);
  hold off
  title('The planned reaching task');
end
