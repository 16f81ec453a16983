function [result, state, status] = sendGoalAndWait(client, goal, timeout)
  global GOAL ANSWER
  GOAL = goal;
  result = ANSWER;
  state = 'succeeded';
  if isempty(result)
    state = 'lost';
  elseif result.ErrorCode ~= 0
    state = 'aborted';
  end
  status = '';
end
