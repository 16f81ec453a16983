"""What a session of `make build` does with a model in which people take something down, and what it leaves when a task fails."""

from __future__ import annotations

import io
import json
from types import SimpleNamespace

import pytest
import rospy
from construction_twin.msg import Execution, Link, Sync, WorkTask, WorkTasks
from construction_twin.srv import WorkDecide, WorkDecideResponse, WorkPlanTask, WorkPlanTaskResponse
from rich.console import Console

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.extensions.work.commands import build
from construction_twin.ros.messages.scene_convert import scene_to_msg
from construction_twin.scene.objects import Scene

REASON = "Shed is to be taken down by people; when it is gone, a person says so: `twin work removed {}`. Note: old"


class WorkNode:
    """In place of the work node: people take down `goes`, and no other task can be planned."""

    def __init__(self, monkeypatch, *tasks: str, goes: tuple[str, ...] = ()):
        rows = [
            WorkTask(
                id=task, name=f"Task {task}", element_name="Shed", element=task, state="ready",
                reason=REASON.format(task) if task in goes else "can be planned",
            )
            for task in tasks
        ]  # fmt: skip
        self.tasks = WorkTasks(model="wall.ifc", schedule="model", tasks=rows)
        self.decisions: list[tuple[str, ...]] = []
        self._goes = goes
        for name, value in (
            ("is_shutdown", lambda: False),
            ("get_namespace", lambda: "/kr120/"),
            ("wait_for_service", lambda *_: None),
            ("ServiceProxy", self._service),
        ):
            monkeypatch.setattr(rospy, name, value)
        tool = SimpleNamespace(tool=SimpleNamespace(grip=SimpleNamespace(confirm={})))
        monkeypatch.setattr(build, "read_tool", lambda _: tool)
        monkeypatch.setattr(build, "Subscriber", lambda *_, **__: SimpleNamespace(get_num_connections=lambda: 1))
        monkeypatch.setattr(build, "warn_of_refusals", lambda: None)

    def _service(self, name, kind):
        if name == "/kr120/work/decide":
            assert kind is WorkDecide
            return self._decide
        assert (name, kind) == ("/kr120/work/plan", WorkPlanTask)
        return lambda task: WorkPlanTaskResponse(success=False, message=f"nothing reaches {task}")

    def _decide(self, task, decision, answer, person, reason):
        self.decisions.append((task, decision, answer, person))
        taken = decision == "removed" and task in self._goes
        if taken:
            next(row for row in self.tasks.tasks if row.id == task).state = "done"
        return WorkDecideResponse(taken, "no", "")

    def run(self, results):
        """Run a session; return what it printed, and its exception."""
        said = io.StringIO()
        settings = build.Settings(results_dir=str(results), arm="mock", tool="tool.yaml", most=0, timeout=1.0)
        builder = build.Builder(settings, Console(file=said, width=200))
        ready = {
            "work/tasks": self.tasks,
            "link": Link(state=Link.ARMED),
            "sync": Sync(state=Sync.IN_SYNC),
            "scene": scene_to_msg(Scene(objects=()), rospy.Time(), "base_link"),
            "execution": Execution(state=Execution.IDLE),
        }
        builder._newest |= ready
        try:
            return said, builder.run()
        except ConstructionTwinError as error:
            return said, error


def figures(results):
    """What a session's file of figures says."""
    (file,) = results.glob("*_build/work.json")
    return json.loads(file.read_text())


def test_it_says_itself_that_what_people_take_down_is_gone_and_has_it_on_record(monkeypatch, tmp_path):
    node = WorkNode(monkeypatch, "a", "b", goes=("a", "b"))
    said, files = node.run(tmp_path)
    assert not isinstance(files, Exception), files
    assert node.decisions == [(task, "removed", "", build.PERSON) for task in "ab"]
    assert "`twin work removed a`" in said.getvalue()
    found = figures(tmp_path)
    assert found["done"] == 2
    assert [one["what"] for one in found["decisions"]] == [f"said that Shed is gone: Task {task}" for task in "ab"]


def test_a_task_that_fails_ends_it_with_a_report_of_what_was_done(monkeypatch, tmp_path):
    node = WorkNode(monkeypatch, "a", "b", "c", goes=("a",))
    _, error = node.run(tmp_path)
    assert isinstance(error, ConstructionTwinError)
    assert "nothing reaches b" in str(error) and "_build" in str(error)
    found = figures(tmp_path)
    assert (found["tasks"], found["done"]) == (3, 1) and len(found["decisions"]) == 1


@pytest.mark.parametrize("lost", [rospy.ServiceException("gone"), rospy.ROSException("timeout exceeded")])
def test_a_service_that_is_gone_ends_it_with_a_report(monkeypatch, tmp_path, lost):
    node = WorkNode(monkeypatch, "a")

    def fails(**_):
        raise lost

    monkeypatch.setattr(rospy, "ServiceProxy", lambda *_: fails)
    _, error = node.run(tmp_path)
    assert isinstance(error, ConstructionTwinError) and str(lost) in str(error)
    assert figures(tmp_path)["tasks"] == 1
