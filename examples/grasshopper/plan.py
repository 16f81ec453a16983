# r: compas_fab==2.0.1, compas_eve==2.4.0
"""Component "plan": a compas_fab JointTrajectory on which the tool passes planes, from where the twin is now.

In:  folder (text), twin (from "connect"), urdf (text: path of the robot's URDF), planes (list of planes in the robot's base),
     units (text: mm or m, those of the Rhino document; there is no default)
Out: trajectory, text (one line)

Any other compas_fab JointTrajectory goes to "send" as well.
"""

import sys

if folder not in sys.path:  # noqa: F821
    sys.path.append(folder)  # noqa: F821

from compas_robots import RobotModel
from twin_grasshopper import TwinProblem, as_frame, trajectory_to_frames

trajectory, text = None, ""
try:
    if twin is None:  # noqa: F821
        raise TwinProblem("not connected")
    start = twin.view().configuration("twin")  # noqa: F821
    frames = [as_frame(plane) for plane in planes]  # noqa: F821
    trajectory = trajectory_to_frames(RobotModel.from_urdf_file(urdf), start, frames, units)  # noqa: F821
    text = f"{len(trajectory.points)} points"
except TwinProblem as problem:
    text = str(problem)
