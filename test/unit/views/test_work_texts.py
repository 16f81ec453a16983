"""Texts about work from a building model: what is read before a schedule is accepted, and what is no measured figure."""

from __future__ import annotations

import math

from construction_twin.views.work_texts import TaskFacts, WorkFacts, list_lines, note_lines

TASK = TaskFacts("T1", "Place plate", "E1", "plate", "done", "", (), "", "", math.nan, math.nan, "", ())


def test_notes_come_behind_the_tasks_of_a_list():
    work = WorkFacts("panel.ifc", "proposed", False, "", "why", (TASK,), ("element E7 is left out",))
    assert note_lines(work) == ["note       element E7 is left out"]
    assert list_lines(work)[-1] == note_lines(work)[0]
    assert "mm" not in "".join(list_lines(work))
