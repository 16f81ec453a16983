"""How well twin and arm agreed: alignment, tables, figures and report of a recording.

In: recorded joint states, feedback, plans, executions and link reports. Out: error tables beside those of the paper, timing,
figures, ``summary.json`` and ``report.html``. May import ``core``, ``robot`` and ``kinematics``.
"""
