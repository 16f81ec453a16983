"""From a goal to a plan: path search, tool paths, time scaling, and the check of what was made.

In: joint goals, poses, tool paths, waypoints; a scene and the present pose. Out: a plan that was checked
against ranges and limits at every 4 ms sample and against the scene there and in between, or a typed error that names the cause.
May import ``core``, ``robot``, ``kinematics`` and ``scene``.
"""
