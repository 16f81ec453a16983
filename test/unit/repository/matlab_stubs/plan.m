function path = plan(planner, start, goal)
  path = [start; (start + goal) / 2 + 0.1; goal];
  if isfield(planner.Robot, 'Closed')
    path = [];
  end
end
