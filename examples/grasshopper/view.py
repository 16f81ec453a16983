# r: compas_fab==2.0.1, compas_eve==2.4.0
"""Component "view": where twin and arm are, and what they do. Put a Grasshopper trigger of 40 ms or more on it.

In:  folder (text), twin (from "connect"), urdf (text: path of the robot's URDF), units (text: mm or m, those of the Rhino document)
Out: twin_configuration, arm_configuration (compas_robots.Configuration, rad and m), twin_frame, arm_frame (COMPAS frames of the
     tool in the robot's base, in the document's units), fresh (false: nothing is known of now), text (a few lines)
"""

import sys

if folder not in sys.path:  # noqa: F821
    sys.path.append(folder)  # noqa: F821

from compas_robots import RobotModel
from twin_grasshopper import TwinProblem, tool_frame

twin_configuration = arm_configuration = twin_frame = arm_frame = None
fresh, text = False, ""
try:
    if twin is None:  # noqa: F821
        raise TwinProblem("not connected")
    view = twin.view()  # noqa: F821
    fresh, text = True, view.text
    model = RobotModel.from_urdf_file(urdf)  # noqa: F821
    twin_configuration = view.configuration("twin")
    twin_frame = tool_frame(model, twin_configuration, units)  # noqa: F821
    arm_configuration = view.configuration("arm")
    arm_frame = tool_frame(model, arm_configuration, units)  # noqa: F821
except TwinProblem as problem:
    text = f"{text}\n{problem}".strip()
