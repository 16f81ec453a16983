"""`make build`: how long it waits for a model, what it leaves when a task fails, and what it answers for people."""

from __future__ import annotations

import io
import json
import math
from types import SimpleNamespace

import pytest
import rospy
from construction_twin.msg import Execution, Link, Sync, ToolState, WorkTask, WorkTasks
from construction_twin.srv import WorkPlanTask, WorkPlanTaskResponse
from rich.console import Console

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.extensions.work.commands import build


@pytest.fixture
def builder(monkeypatch, tmp_path):
    """A session of two tasks, the first of which is done, without a master."""
    for name, value in (
        ("is_shutdown", lambda: False),
        ("get_namespace", lambda: "/kr120/"),
        ("wait_for_service", lambda *_: None),
    ):
        monkeypatch.setattr(rospy, name, value)
    monkeypatch.setattr(build, "Subscriber", lambda *_, **__: None)
    monkeypatch.setattr(build, "warn_of_refusals", lambda: None)
    grip = SimpleNamespace(confirm={"vacuum_reached": True})
    monkeypatch.setattr(build, "read_tool", lambda _: SimpleNamespace(tool=SimpleNamespace(grip=grip)))
    settings = build.Settings(results_dir=str(tmp_path), arm="mock", tool="tool.yaml", most=0, timeout=0.2)
    one = build.Builder(settings, Console(file=io.StringIO(), width=200))
    rows = [
        WorkTask(id=task, name=f"Task {task}", element=task, state=state, deviation_mm=0.013, mass_kg=math.nan)
        for task, state in (("a", "done"), ("b", "ready"))
    ]
    one._newest |= {
        "work/tasks": WorkTasks(model="wall.ifc", schedule="model", tasks=rows),
        "link": Link(state=Link.ARMED),
        "sync": Sync(state=Sync.IN_SYNC),
        "execution": Execution(state=Execution.IDLE),
    }
    return one


@pytest.mark.parametrize(
    ("work", "said"),
    [
        (WorkTasks(model="wall.ifc", reason="wall.ifc: no length unit"), r"cannot be read: wall\.ifc: no length unit"),
        (WorkTasks(model="wall.ifc", reading=True, reason="reading"), "waited 0.2 s in vain for a work node.*reading"),
        (WorkTasks(), "waited 0.2 s in vain for a work node.*no report"),
    ],
)
def test_a_model_that_is_not_read_ends_it_with_the_reason(builder, work, said):
    builder._newest["work/tasks"] = work
    with pytest.raises(ConstructionTwinError, match=said):
        builder.run()


def refused(name, kind):
    """In place of `rospy.ServiceProxy`: nothing can be planned."""
    assert (name, kind) == ("/kr120/work/plan", WorkPlanTask)
    return lambda task: WorkPlanTaskResponse(success=False, message=f"nothing reaches {task}")


def lost(name, kind):
    """In place of `rospy.ServiceProxy`: the node is gone."""

    def fails(**_):
        raise rospy.ServiceException("gone")

    return fails


@pytest.mark.parametrize(("service", "said"), [(refused, "nothing reaches b"), (lost, "gone")])
def test_a_task_that_fails_ends_it_with_the_figures_of_what_was_done(monkeypatch, tmp_path, builder, service, said):
    monkeypatch.setattr(rospy, "ServiceProxy", service)
    with pytest.raises(ConstructionTwinError, match=f"{said}.*_build"):
        builder.run()
    (file,) = tmp_path.glob("*_build/work.json")
    found = json.loads(file.read_text())
    assert (found["tasks"], found["done"]) == (2, 1)
    first, second = found["elements"]
    assert (first["element"], first["state"], first["deviation_mm"]) == ("a", "done", 0.013)
    assert (second["state"], second["mass_kg"]) == ("ready", None)


@pytest.mark.parametrize(
    ("known", "vacuum", "answers", "answer"),
    [
        (True, True, ("in_stock", "in_grip", "placed", "gone"), "in_grip"),
        (True, False, ("in_stock", "in_grip", "placed", "gone"), "in_stock"),
        (True, True, ("in_stock", "gone"), None),
        (False, True, ("in_stock", "in_grip"), None),
    ],
)
def test_it_answers_by_what_the_tool_confirms(monkeypatch, builder, known, vacuum, answers, answer):
    row = WorkTask(id="b", name="Task b", state="asks", question="where is b now?", answers=answers)
    builder._newest["tool"] = ToolState(known=known, inputs=["vacuum_reached"], input_values=[vacuum])
    asked = []
    monkeypatch.setattr(builder, "_decide", lambda *words: asked.append(words))
    if answer is None:
        with pytest.raises(ConstructionTwinError, match="is surely true"):
            builder._answer(row)
    else:
        builder._answer(row)
    assert asked == ([] if answer is None else [("answer", "b", answer)])
