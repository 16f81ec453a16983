"""A person decides: the queue of plans and verdicts, and the record of every verdict.

In: plans, and verdicts that name a plan by id and hash. Out: approvals, each for one execution of one trajectory, and an
append-only file that is written before anything moves. May import ``core`` and ``robot``.
"""
