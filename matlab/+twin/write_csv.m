function write_csv(file, joints, linear, t, q, qd, qdd)
%WRITE_CSV  Write a motion as a file for `twin plan --csv FILE`, with its columns named and every digit.
%
%   twin.write_csv(file, joints, linear, t, q, qd, qdd)
%
%   linear  logical, one per joint: prismatic. t may be [] (the planner times the path), and so may qd and qdd.
  units = repmat({'rad'}, 1, numel(joints));
  units(logical(linear)) = {'m'};
  names = {};
  table = [];
  if ~isempty(t)
    names = {'time_s'};
    table = t(:);
  end
  groups = {q, qd, qdd};
  rates = {'', '_s', '_s2'};
  for g = 1:3
    if ~isempty(groups{g})
      for j = 1:numel(joints)
        names{end + 1} = [joints{j} '_' units{j} rates{g}]; %#ok<AGROW>
      end
      table = [table, groups{g}]; %#ok<AGROW>
    end
  end
  out = fopen(file, 'w');
  if out < 0
    error('twin:write_csv', '%s cannot be written; expected a folder that files can be written into', file);
  end
  closing = onCleanup(@() fclose(out));
  fprintf(out, '%s\n', strjoin(names, ','));
  pattern = [strjoin(repmat({'%.17g'}, 1, numel(names)), ',') '\n'];
  fprintf(out, pattern, table');
end
