"""The one place that catches what a request for a plan fails by: every request is answered, one at a time."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest
from planning_cell import HOME, LEFT, QUICK, REQUEST, ROBOT, SELF_COLLISION, Clock, solver

from construction_twin.planning import requests
from construction_twin.planning.pipeline import PlanningPipeline
from construction_twin.planning.planner import PlannerSettings
from construction_twin.planning.requests import PlanRequests
from construction_twin.planning.waypoints import from_points
from construction_twin.scene.objects import Scene


class Cell:
    """Requests with a pipeline of their own; remembers what was published."""

    def __init__(self):
        self.pipeline = PlanningPipeline(ROBOT, solver(), PlannerSettings(**QUICK), SELF_COLLISION, Clock(), "/scene")
        self.pipeline.set_scene(Scene(padding=0.01))
        self.published: list = []
        self.requests = PlanRequests(lambda: None, lambda *said: self.published.append(said))

    def plan(self, plan_id: str = "p1"):
        asked = replace(REQUEST, plan_id=plan_id)
        return self.requests.answer(asked, lambda: lambda: self.pipeline.to_joints(HOME, LEFT, asked))


@pytest.mark.parametrize(
    "error", [MemoryError(), ValueError("shapes"), OverflowError("large"), ZeroDivisionError(), np.linalg.LinAlgError("singular")]
)  # fmt: skip
@pytest.mark.parametrize("while_reading", [False, True])
def test_what_no_check_foresaw_is_answered_too(error, while_reading):
    cell = Cell()

    def fail():
        raise error

    answer = cell.requests.answer(REQUEST, fail if while_reading else lambda: fail)
    name = type(error).__name__
    assert answer.success is False and name in answer.message and (answer.failure, name in answer.trace) == (name, True)
    assert cell.plan().success  # and the lock is free
    ((plan, _, _, published),) = cell.published
    assert plan.id == published.plan_id and "waiting for review" in published.message


def test_an_answer_says_why_times_were_replaced():
    cell = Cell()
    points = from_points(ROBOT, ROBOT.joint_names, [HOME, np.add(HOME, 0.1)], times=[0.0, 0.2])
    answer = cell.requests.answer(REQUEST, lambda: lambda: cell.pipeline.through(HOME, points, REQUEST, retime=True))
    assert answer.success and "has an acceleration of" in answer.retimed and answer.duration > 0.2
    assert cell.plan().retimed == ""


def test_a_verdict_that_is_heard_late_counts(monkeypatch):
    monkeypatch.setattr(requests, "VERDICT_TIME", 60.0)
    cell = Cell()
    first = cell.plan().plan_id
    threading.Timer(0.05, cell.requests.on_verdict, [first]).start()
    assert cell.plan("p2").plan_id == "p2"


def test_reading_holds_nobody_up():
    cell = Cell()

    def read():
        # a request that comes meanwhile is answered
        assert cell.plan("p2").plan_id == "p2"
        return lambda: cell.pipeline.to_joints(HOME, LEFT, REQUEST)

    assert cell.requests.answer(REQUEST, read).success
