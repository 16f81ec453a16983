"""What the arm is: its description, its frames, and the trajectory and plan that it can be given.

In: URDF text and robot YAML; times and joint positions. Out: frozen records of joints, limits, poses, trajectories and plans,
and the hash by which an approval names a trajectory. May import ``core``.
"""
