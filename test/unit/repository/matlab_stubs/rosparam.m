function value = rosparam(word, name)
  value = [word ' ' name];
end
