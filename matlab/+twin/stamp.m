function seconds = stamp(header)
%STAMP  The stamp of a std_msgs/Header structure [s].
  seconds = double(header.Stamp.Sec) + 1e-9 * double(header.Stamp.Nsec);
end
