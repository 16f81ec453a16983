"""A node that cannot start ends the launch in its first minute, and never once something was played."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import rospy
from construction_twin.msg import StartRefused
from scene_samples import kr120

from construction_twin.ros.nodes import startup as module
from construction_twin.ros.nodes.startup import LATE, Settings, StartupNode
from construction_twin.ros.shared.start_refusal import VARIABLE


@pytest.mark.parametrize(
    "after, state, ends",
    [(0.0, "", True), (LATE - 0.1, "IDLE", True), (LATE + 0.1, "IDLE", False), (1.0, "PLAYING", False)],
)
def test_a_refusal_ends_the_launch_while_that_cannot_leave_an_arm_in_the_midst(monkeypatch, after, state, ends):
    now, hears, said = [1000.0], {}, []
    execution = SimpleNamespace(text=state, reason="") if state else None
    snapshot = SimpleNamespace(link=None, sync=None, execution=execution, silent={})
    monkeypatch.setenv(VARIABLE, "this")
    monkeypatch.setattr(module, "RobotListener", lambda *_: SimpleNamespace(snapshot=lambda: snapshot))
    monkeypatch.setattr(module, "Subscriber", lambda topic, _kind, callback, *_, **__: hears.update({topic: callback}))
    monkeypatch.setattr(module, "COLLECT", 0.0)
    monkeypatch.setattr(rospy, "logerr", lambda form, *values: said.append(form % values))
    node = StartupNode(Settings(arm="mock", broker="b:1", rsi="r:2", gateway=True), kr120(), None, lambda: now[0])
    now[0] += after
    for launch in ("another", "this"):
        refused = StartRefused(launch, f"the sentence of {launch}")
        refused._connection_header = {"callerid": "/kr120/planner"}
        hears["start_refused"](refused)
    node.update()
    if ends:
        with pytest.raises(SystemExit):
            node.run()
    assert said == ([] if ends else ["cannot start: the sentence of this (/kr120/planner)"])
