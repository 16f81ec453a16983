# r: compas_fab==2.0.1, compas_eve==2.4.0
"""Component "send": sends a trajectory for review, once for each press of a button. Nothing moves before a person approves.

In:  folder (text), twin (from "connect"), trajectory (a compas_fab JointTrajectory), source (text: who asks, for the reviewer),
     send (a button)
Out: sent (the id of what was sent last, for "answer"), text (one line)
"""

import sys

if folder not in sys.path:  # noqa: F821
    sys.path.append(folder)  # noqa: F821

import twin_grasshopper

sent, text = "" if twin is None else twin.last_sent, ""  # noqa: F821
try:
    if send and twin is not None:  # noqa: F821
        sent = twin.send(trajectory, source or "")  # noqa: F821
        text = "sent; the answer proves that it arrived"
except twin_grasshopper.TwinProblem as problem:
    text = str(problem)
