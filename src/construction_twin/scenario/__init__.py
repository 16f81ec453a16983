"""Faults on demand and their judgement: definition, time line, checks and table.

In: a scenario file, a recording, the gateway's trace. Out: a verdict with checks and figures, and the table of
docs/scenarios.md. May import ``core``, ``gateway``, ``mock`` and ``evaluation``.
"""
