"""The arm with mass: a MuJoCo model of arm, load and scene, and the rehearsal of a plan in it.

In: a robot, a scene, masses, drives, a plan. Out: torques, contacts, what falls. Needs the set-up's group ``physics``.
May import the core.
"""
