"""Faults on demand and their judgement: definition, time line, checks.

In: a scenario file, a recording, the gateway's trace. Out: a verdict with checks and figures. May import ``core``,
``gateway``, ``mock`` and ``evaluation``.
"""
