"""From a goal to a plan: path search, tool paths, time scaling, and the check of what was made.

In: goals, tool paths, waypoints; a scene and the present pose. Out: a plan checked against ranges and limits at every 4 ms sample
and against the scene there and in between, or a typed error. May import ``core``, ``robot``, ``kinematics`` and ``scene``.
"""
