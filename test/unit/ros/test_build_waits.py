"""`make build` waits for a model as long as the work node reads it, and not for one that cannot come."""

from __future__ import annotations

import io

import pytest
from construction_twin.msg import WorkTasks
from rich.console import Console
from sentence_checks import says

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.ros.commands import build


class Clock:
    """Time that goes on by 30 s whenever news are waited for; `said` is what the node says by then."""

    def __init__(self, monkeypatch, said, is_there=True):
        self.now, self._said, self._is_there = 0.0, iter(said), is_there
        self._newest = None
        self._out = io.StringIO()
        monkeypatch.setattr(build.time, "monotonic", lambda: self.now)

    def _pause(self):
        self.now += 30.0
        self._newest = next(self._said, self._newest)

    def wait(self):
        """Wait for the model; return what was printed."""
        with build.waiting(Console(file=self._out, width=200), "reading the model", 0.0) as tell:
            build.wait_for_model(lambda: self._newest, lambda: self._is_there, self._pause, tell, 120.0)
        return self._out.getvalue()


READING = WorkTasks(model="wall.ifc", reading=True, reason="the model is being read")


def test_a_model_that_cannot_be_read_ends_it_at_once_with_the_reason(monkeypatch):
    clock = Clock(monkeypatch, [READING, WorkTasks(model="wall.ifc", reason="wall.ifc: no length unit")])
    with pytest.raises(ConstructionTwinError, check=says("view.build.no_model", reason="wall.ifc: no length unit")):
        clock.wait()
    assert clock.now < 120.0


def test_a_node_that_is_gone_is_not_waited_for_any_longer_than_the_timeout(monkeypatch):
    clock = Clock(monkeypatch, [READING], is_there=False)
    with pytest.raises(ConstructionTwinError, check=says("view.build.no_reader", seconds=120.0)):
        clock.wait()
