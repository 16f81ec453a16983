"""The virtual robot: what it does with a command, and how it follows the arm in mirror mode.

In: commands that passed the gate; in mirror mode the measured pose of the arm. Out: the twin's pose and its stamp. May import
``core``.
"""
