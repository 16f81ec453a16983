function plot_figure9(result, joints)
%PLOT_FIGURE9  The paper's Figure 9: the joint angles of the virtual and of the physical arm over time, from twin.compare_arms.
  figure('Name', 'Figure 9');
  colours = get(gca, 'ColorOrder');
  hold on
  for j = 1:numel(joints)
    colour = colours(mod(j - 1, size(colours, 1)) + 1, :);
    plot(result.t, result.twin(:, j), '-', 'Color', colour, 'DisplayName', [strrep(joints{j}, '_', ' ') ' virtual']);
    plot(result.t, result.arm(:, j), '--', 'Color', colour, 'LineWidth', 2, 'DisplayName', [strrep(joints{j}, '_', ' ') ' physical']);
  end
  hold off
  xlabel('time [s]');
  ylabel('joint angle [rad]');
  title('Joint angles of the virtual and the physical arm');
  legend('show', 'Location', 'eastoutside');
end
