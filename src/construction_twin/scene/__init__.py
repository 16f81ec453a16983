"""What the arm must not touch: objects, carried objects, the arm's own body, and another arm.

In: the scene's YAML and edits, a robot description, joint positions. Out: contacts, clearances, bounds of distances along a
motion, and the version (hash) of a scene. May import ``core``, ``robot`` and ``kinematics``.
"""
