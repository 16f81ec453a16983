"""The terminal view: bars, rates, latency, counters and states of a snapshot."""

from __future__ import annotations

import io

from rich.console import Console
from scene_samples import kr120

from construction_twin.core.reports import LinkReport, SyncReport
from construction_twin.ros.commands.watch import render
from construction_twin.views.snapshot import NodeFacts, Snapshot


def shown(**changes) -> str:
    robot = kr120()
    console = Console(file=io.StringIO(), width=100, record=True)
    console.print(render(Snapshot("kr120", 105.0, robot.joint_names, robot.linear, **changes)))
    return console.export_text()


def test_a_report_that_fell_silent_is_not_shown_as_the_present():
    sync = SyncReport("IN_SYNC", "the poses agree", "replan", "aligned", (0.001,) * 6, (0.01,) * 6)
    text = shown(link=LinkReport("ARMED", "commands flow"), sync=sync, silent={"sync": 4.2, "link": 7.0})
    assert "silent for 4 s; the last was IN_SYNC" in text and "silent for 7 s; the last was ARMED" in text
    assert "nothing is compared" in text


def test_what_a_node_says_is_no_markup():
    assert "[bold]x[/bold]" in shown(nodes=(NodeFacts("scene", 2, "[bold]x[/bold]"),))
