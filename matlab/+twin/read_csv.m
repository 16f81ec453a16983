function [names, table] = read_csv(file)
%READ_CSV  Read what `twin export FILE` writes, or twin.write_csv: names of the columns (a cell array) and the numbers (a matrix).
%
%   readtable(file, "CommentStyle", "#") gives the same as a table. This function needs no newer MATLAB.
  text = fileread(file);
  lines = regexp(text, '\r?\n', 'split');
  lines = lines(~cellfun(@(line) isempty(line) || line(1) == '#', lines));
  names = strsplit(lines{1}, ',');
  table = zeros(numel(lines) - 1, numel(names));
  for k = 2:numel(lines)
    row = sscanf(lines{k}, '%g,')';
    if numel(row) ~= numel(names)
      error('twin:read_csv', '%s: row %d has %d numbers; expected %d', file, k - 1, numel(row), numel(names));
    end
    table(k - 1, :) = row;
  end
end
