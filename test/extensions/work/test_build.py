"""`make build`: how long it waits for a model, what it leaves when a task fails, and what it answers for people."""

from __future__ import annotations

import io
import json
import math
from types import SimpleNamespace

import pytest
import rospy
from construction_twin.msg import Execution, Link, Sync, WorkTask, WorkTasks
from construction_twin.srv import WorkPlanTask, WorkPlanTaskResponse
from rich.console import Console

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.extensions.work.commands import build

READING = WorkTasks(model="wall.ifc", reading=True, reason="the model is being read")


class Waiting(build.Builder):
    """Its time goes on by 30 s whenever it waits for news; `said` is what the node says by then."""

    def __init__(self, monkeypatch, said, is_there=True):
        self.now, self._said, self._newest = 0.0, iter(said), {"execution": Execution()}
        self._settings = SimpleNamespace(timeout=120.0)
        self._subscribers = {"work/tasks": SimpleNamespace(get_num_connections=lambda: int(is_there))}
        monkeypatch.setattr(build.time, "monotonic", lambda: self.now)

    def _pause(self):
        self.now += 30.0
        self._newest |= {"work/tasks": work for work in [next(self._said, None)] if work is not None}

    def wait(self):
        self._wait(self._is_read, "a work node that reads the model", self._is_reading)


def test_a_model_that_cannot_be_read_ends_it_at_once_with_the_reason(monkeypatch):
    waiting = Waiting(monkeypatch, [READING, WorkTasks(model="wall.ifc", reason="wall.ifc: no length unit")])
    with pytest.raises(ConstructionTwinError, match=r"the model cannot be read: wall\.ifc: no length unit"):
        waiting.wait()
    assert waiting.now < 120.0


def test_a_node_that_is_gone_is_not_waited_for_any_longer_than_the_timeout(monkeypatch):
    waiting = Waiting(monkeypatch, [READING], is_there=False)
    with pytest.raises(ConstructionTwinError, match="waited 120 s in vain for a work node"):
        waiting.wait()


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
def test_a_task_that_fails_ends_it_with_the_figures_of_what_was_done(monkeypatch, tmp_path, service, said):
    for name, value in (
        ("is_shutdown", lambda: False),
        ("get_namespace", lambda: "/kr120/"),
        ("wait_for_service", lambda *_: None),
        ("ServiceProxy", service),
    ):
        monkeypatch.setattr(rospy, name, value)
    monkeypatch.setattr(build, "Subscriber", lambda *_, **__: SimpleNamespace(get_num_connections=lambda: 1))
    monkeypatch.setattr(build, "warn_of_refusals", lambda: None)
    grip = SimpleNamespace(confirm={})
    monkeypatch.setattr(build, "read_tool", lambda _: SimpleNamespace(tool=SimpleNamespace(grip=grip)))
    settings = build.Settings(results_dir=str(tmp_path), arm="mock", tool="tool.yaml", most=0, timeout=1.0)
    console = io.StringIO()
    builder = build.Builder(settings, Console(file=console, width=200))
    rows = [
        WorkTask(id=task, name=f"Task {task}", element=task, state=state, deviation_mm=0.013, mass_kg=math.nan)
        for task, state in (("a", "done"), ("b", "ready"))
    ]
    builder._newest |= {
        "work/tasks": WorkTasks(model="wall.ifc", schedule="model", tasks=rows),
        "link": Link(state=Link.ARMED),
        "sync": Sync(state=Sync.IN_SYNC),
        "execution": Execution(state=Execution.IDLE),
    }
    with pytest.raises(ConstructionTwinError, match=f"{said}.*_build"):
        builder.run()
    (file,) = tmp_path.glob("*_build/work.json")
    found = json.loads(file.read_text())
    assert (found["tasks"], found["done"], found["decisions"]) == (2, 1, [])
    first, second = found["elements"]
    assert (first["element"], first["state"], first["deviation_mm"], first["plans"]) == ("a", "done", 0.013, 0)
    assert (second["state"], second["mass_kg"], second["planning_s"]) == ("ready", None, 0.0)
    assert "0.013" in console.getvalue()


CONFIRM = {"vacuum_reached": True}
ALL = ("in_stock", "in_grip", "placed", "gone")


@pytest.mark.parametrize(
    ("inputs", "last", "answers", "answer"),
    [
        ({"vacuum_reached": True}, "carrying", ALL, "in_grip"),
        ({"vacuum_reached": True}, "releasing", ALL, "in_grip"),
        ({"vacuum_reached": False}, "releasing", ALL, "placed"),
        ({"vacuum_reached": False, "other": True}, "carrying", ALL, "gone"),
        ({"vacuum_reached": False}, "gripping", ALL, "in_stock"),
        ({}, "", ALL, "in_stock"),
        ({"vacuum_reached": True}, "", ("in_stock", "gone"), ""),
        (None, "", ALL, ""),
    ],
)
def test_placed_is_only_what_was_being_released_and_held_what_the_tool_confirms(inputs, last, answers, answer):
    assert build.answer_of(inputs, CONFIRM, last, answers) == answer
