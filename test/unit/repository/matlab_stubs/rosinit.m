function rosinit(master, varargin)
  printf('rosinit %s', master);
  printf(' %s', varargin{:});
  printf('\n');
end
