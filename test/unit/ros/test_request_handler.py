"""The planner's one place that catches: every request is answered, one at a time, and none without a scene."""

from __future__ import annotations

import threading
from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from planning_cell import HOME, LEFT, QUICK, REQUEST, ROBOT, SELF_COLLISION, Clock, solver

from construction_twin.planning.pipeline import PlanningPipeline
from construction_twin.planning.planner import PlannerSettings
from construction_twin.planning.waypoints import from_points
from construction_twin.ros.shared import request_handler
from construction_twin.ros.shared.request_handler import RequestHandler
from construction_twin.scene.objects import Scene

EMPTY = Scene(padding=0.01)


class Cell:
    """A handler with a pipeline of its own; remembers what it published and counted."""

    def __init__(self, publishers: int = 1):
        self.pipeline = PlanningPipeline(ROBOT, solver(), PlannerSettings(**QUICK), SELF_COLLISION, Clock(), "/scene")
        self.pipeline.set_scene(EMPTY)
        self.publishers = publishers
        self.refused: Counter[str] = Counter()
        self.outcomes: list = []
        diagnostics = SimpleNamespace(count=lambda reason, _: self.refused.update([reason]))
        self.handler = RequestHandler(
            self.pipeline, diagnostics, lambda: self.publishers, 0.0, lambda plan, changes: "made", self.note
        )

    def note(self, success, asked, sentence, plan_id):
        self.outcomes.append((success, sentence))

    def plan(self, asked):
        return self.pipeline.to_joints(HOME, LEFT, asked)


@pytest.mark.parametrize(
    "error", [MemoryError(), ValueError("shapes"), OverflowError("large"), ZeroDivisionError(), np.linalg.LinAlgError("singular")]
)  # fmt: skip
@pytest.mark.parametrize("while_reading", [False, True])
def test_what_no_check_foresaw_is_answered_too(error, while_reading):
    cell = Cell()

    def fail(*_):
        raise error

    answer = cell.handler.answer_read(fail, REQUEST) if while_reading else cell.handler.answer(fail, REQUEST)
    assert answer.success is False and type(error).__name__ in answer.message
    assert cell.outcomes == [(False, answer.message)] and cell.refused == {type(error).__name__: 1}
    assert cell.handler.answer(cell.plan, REQUEST).success  # and the lock is free
    assert cell.outcomes[1:] == [(True, "made")]


def test_an_answer_says_why_times_were_replaced():
    cell = Cell()
    points = from_points(ROBOT, ROBOT.joint_names, [HOME, np.add(HOME, 0.1)], times=[0.0, 0.2])
    answer = cell.handler.answer(lambda asked: cell.pipeline.through(HOME, points, asked, retime=True), REQUEST)
    assert answer.success and "has an acceleration of" in answer.fields["retimed"] and answer.fields["duration"] > 0.2
    assert cell.handler.answer(cell.plan, REQUEST).fields["retimed"] == ""


def test_a_verdict_that_is_heard_late_counts(monkeypatch):
    monkeypatch.setattr(request_handler, "VERDICT_TIME", 60.0)
    cell = Cell()
    first = cell.handler.answer(cell.plan, REQUEST).fields["plan_id"]

    def plan(asked):
        threading.Timer(0.05, cell.handler.on_verdict, [first]).start()
        return cell.plan(asked)

    assert cell.handler.answer(plan, replace(REQUEST, plan_id="p2")).fields["plan_id"] == "p2"


def test_reading_holds_nobody_up():
    cell = Cell()

    def read():
        # a request that comes meanwhile is answered
        assert cell.handler.answer(cell.plan, replace(REQUEST, plan_id="p2")).fields["plan_id"] == "p2"
        return cell.plan

    assert cell.handler.answer_read(read, REQUEST).success


def test_without_the_scene_s_publisher_nothing_is_planned_until_a_scene_comes():
    cell = Cell(publishers=0)
    answer = cell.handler.answer(cell.plan, REQUEST)
    assert not answer.success and "the scene node is not running" in answer.message
    cell.publishers = 1
    assert not cell.handler.answer(cell.plan, REQUEST).success
    cell.pipeline.set_scene(EMPTY)
    assert cell.handler.answer(cell.plan, REQUEST).success
