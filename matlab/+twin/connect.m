function [robot, joints, linear] = connect(master, namespace, host)
%CONNECT  Join the ROS network of the digital twin and import its arm.
%
%   [robot, joints, linear] = twin.connect(master, namespace)
%   [robot, joints, linear] = twin.connect(master, namespace, host)
%
%   master     e.g. 'http://192.168.1.5:11311', what ROS_MASTER_URI is on the twin's PC
%   namespace  of the robot, e.g. '/kr120'
%   host       address of this PC that the twin's PC can reach; without it MATLAB's choice
%
%   robot   rigidBodyTree of the URDF in the parameter robot_description, rows as configurations
%   joints  names of the joints that move, in the order of a configuration
%   linear  which of them are prismatic
%
%   This MATLAB's node is /matlab, the name that plans are shown with and auto_approve_sources takes. A second MATLAB that connects
%   takes the name over, and the first one's node ends.
%
%   ROS Toolbox and Robotics System Toolbox. Pictures of the links are not found unless the package lies below one of the folders
%   given to importrobot as "MeshPath"; a warning says so, and everything else works.
  % without a name of its own MATLAB's node is called otherwise in every session
  if nargin < 3
    rosinit(master, 'NodeName', '/matlab');
  else
    rosinit(master, 'NodeHost', host, 'NodeName', '/matlab');
  end
  urdf = rosparam('get', [char(namespace) '/robot_description']);
  robot = importrobot(urdf, 'DataFormat', 'row');
  joints = {};
  linear = logical([]);
  for k = 1:robot.NumBodies
    joint = robot.Bodies{k}.Joint;
    if ~strcmp(joint.Type, 'fixed')
      joints{end + 1} = joint.Name; %#ok<AGROW>
      linear(end + 1) = strcmp(joint.Type, 'prismatic'); %#ok<AGROW>
    end
  end
end
