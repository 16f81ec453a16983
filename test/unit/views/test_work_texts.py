"""Texts about work from a building model: what is read before a schedule is accepted, and what is no measured figure."""

from __future__ import annotations

from construction_twin.core.reports import TaskReport, WorkReport
from construction_twin.ros.commands.twin_work import list_lines, note_lines

TASK = TaskReport(id="T1", name="Place plate", element="E1", element_name="plate", state="done", reason="", after=())


def test_notes_come_behind_the_tasks_of_a_list():
    work = WorkReport(
        model="panel.ifc", model_hash="", schedule="proposed", engaged=False, next="", reason="why", tasks=(TASK,),
        notes=("element E7 is left out",),
    )  # fmt: skip
    assert note_lines(work) == ["note       element E7 is left out"]
    assert list_lines(work)[-1] == note_lines(work)[0]
    assert "mm" not in "".join(list_lines(work))
