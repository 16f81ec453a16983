"""How well twin and arm agreed: alignment, tables, figures and report of a recording.

In: joint states, feedback, plans, executions and link reports, of a bag or another recording. Out: error tables beside those of
the paper, timing, figures, ``summary.json`` and ``report.html``. May import ``core``,
``servo``, ``robot`` and ``kinematics``.
"""
