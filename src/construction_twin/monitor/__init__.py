"""Algorithm 1 of the paper as a gate in the command path.

In: next setpoints, poses of the twin and of the physical arm, the state of plan and link. Out: the setpoints that may pass, the
gate's state, its transitions and their log, and requests for a new plan. May import ``core``, ``servo``, ``review``
and ``mqtt``.
"""
