"""Poses and joints: forward kinematics, closed-form and numerical inverse kinematics, singularities.

In: a robot description, a pose or joint values. Out: joint solutions with their residuals, or a typed error that says why there
is none. May import ``core`` and ``robot``.
"""
