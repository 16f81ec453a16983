"""A person decides: the plan under review, the record of every verdict, and the report of a rehearsal.

In: plans, and verdicts that name a plan by id and hash. Out: an append-only file that is written before anything moves. Who
approves is in ``execution/approval.py``. May import ``core`` and ``robot``.
"""
