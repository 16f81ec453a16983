"""Two arms in one cell: whether the paths of both meet, and which arm gives way.

In: plans, poses, executions and scenes of both arms. Out: a verdict for the plan that waits and for the one that is played. May
import ``core``, ``robot``, ``kinematics``, ``scene``, ``planning`` and ``execution``.
"""
