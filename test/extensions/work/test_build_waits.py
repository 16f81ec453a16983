"""`make build` waits for a model as long as the work node reads it, and not for one that cannot come."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from construction_twin.msg import WorkTasks

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.extensions.work.commands import build


class Waiting(build.Builder):
    """Its time goes on by 30 s whenever it waits for news; `said` is what the node says by then."""

    def __init__(self, monkeypatch, said, is_there=True):
        self.now, self._said, self._newest = 0.0, iter(said), {}
        self._settings = SimpleNamespace(timeout=120.0)
        self._subscribers = {"work/tasks": SimpleNamespace(get_num_connections=lambda: int(is_there))}
        self._say = lambda _: None
        monkeypatch.setattr(build.time, "monotonic", lambda: self.now)

    def _pause(self):
        self.now += 30.0
        self._newest["work/tasks"] = next(self._said, self._newest.get("work/tasks"))

    def wait(self):
        self._wait_for_model(0.0)


READING = WorkTasks(model="wall.ifc", reading=True, reason="the model is being read")


def test_a_model_that_cannot_be_read_ends_it_at_once_with_the_reason(monkeypatch):
    waiting = Waiting(monkeypatch, [READING, WorkTasks(model="wall.ifc", reason="wall.ifc: no length unit")])
    with pytest.raises(ConstructionTwinError, match=r"the model cannot be read: wall\.ifc: no length unit"):
        waiting.wait()
    assert waiting.now < 120.0


def test_a_node_that_is_gone_is_not_waited_for_any_longer_than_the_timeout(monkeypatch):
    waiting = Waiting(monkeypatch, [READING], is_there=False)
    with pytest.raises(ConstructionTwinError, match="waited 120 s in vain for a work node"):
        waiting.wait()
