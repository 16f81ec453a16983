"""The terminal view: bars, rates, latency, counters and states of a snapshot."""

from __future__ import annotations

import io
import math

import pytest
from rich.console import Console
from scene_samples import kr120

from construction_twin.core.reports import ExecutionReport, LinkReport, SyncReport
from construction_twin.ros.commands.watch import BAR, bar, render
from construction_twin.views.snapshot import NodeFacts, Snapshot


def shown(**changes) -> str:
    robot = kr120()
    console = Console(file=io.StringIO(), width=100, record=True)
    console.print(render(Snapshot("kr120", 105.0, robot.joint_names, robot.linear, **changes)))
    return console.export_text()


@pytest.mark.parametrize(
    "error, threshold, full, style",
    [
        (0.0, 1.0, 0, "green"), (0.4, 1.0, 9, "green"), (0.6, 1.0, 14, "yellow"), (0.999, 1.0, BAR - 1, "yellow"),
        (1.0, 1.0, BAR, "yellow"), (1.001, 1.0, BAR, "red"), (5.0, 1.0, BAR, "red"), (0.1, 0.0, BAR, "red"),
    ],
)  # fmt: skip
def test_a_bar_is_full_at_the_threshold(error, threshold, full, style):
    drawn = bar(error, threshold)
    assert drawn.plain.count("█") == full and len(drawn.plain) == BAR
    if full:
        assert drawn.spans[0].style == style


@pytest.mark.parametrize("error, threshold", [(math.nan, 1.0), (math.inf, 1.0), (0.0, math.nan)])
def test_no_number_is_no_bar(error, threshold):
    assert set(bar(error, threshold).plain) == {"?"}


def test_a_report_that_fell_silent_is_not_shown_as_the_present():
    sync = SyncReport("IN_SYNC", "the poses agree", "replan", "aligned", (0.001,) * 6, (0.01,) * 6)
    text = shown(link=LinkReport("ARMED", "commands flow"), sync=sync, silent={"sync": 4.2, "link": 7.0})
    assert "silent for 4 s; the last was IN_SYNC" in text and "silent for 7 s; the last was ARMED" in text
    assert "nothing is compared" in text


def test_a_picture_of_a_running_system():
    sync = SyncReport(
        "IN_SYNC",
        "the poses agree",
        "replan",
        "aligned",
        (0.0, 0.001, 0.002, 0.0, 0.0, 0.02),
        (0.01,) * 6,
        0.0263,
        0.008,
        3,
    )
    counters = {"late_replies": "7", "playout_jitter_ms": "1.5", "refused_stale": "2", "refused_velocity": "1"}
    text = shown(
        link=LinkReport("ARMED", "commands flow", "following", counters, 4, 5),
        sync=sync,
        execution=ExecutionReport(
            "PLAYING", "", "p1", plan_start=100_000_000_000, duration=20.0, speed_limit=0.5, rate=0.4
        ),
        rates={"twin": 250.04, "physical": None},
        nodes=(NodeFacts("planner", 0, "ok"), NodeFacts("scene", 1, "in contact")),
    )
    for part in (
        "IN_SYNC: the poses agree", "25% of 20.0 s", "50% of the planned speed allowed, 40% now",
        "1.1459 deg of 0.5730 deg", "twin 250.0 Hz  physical ? Hz", "round trip 26.3 ms  servo lag 8.0 ms",
        "late replies 7", "lost commands 0", "gateway 3  bridge 4 commands, 5 states", "jitter 1.5 ms, delay ? ms",
        "left IN_SYNC 3 times, policy replan", "1 of 2 report no problem", "scene: in contact",
    ):  # fmt: skip
        assert part in text


def test_a_picture_of_silence():
    text = shown()
    assert text.count("no report") == 3 and "nothing is compared" in text and "no link" in text and "0 of 0" in text


def test_linear_joints_are_in_mm():
    sync = SyncReport("IN_SYNC", "", error=(0.001,), threshold=(0.002,))
    console = Console(file=io.StringIO(), width=100, record=True)
    console.print(render(Snapshot("x", 0.0, ("rail",), (True,), sync=sync)))
    assert "1.0000 mm of 2.0000 mm" in console.export_text()


def test_what_a_node_says_is_no_markup():
    assert "[bold]x[/bold]" in shown(nodes=(NodeFacts("scene", 2, "[bold]x[/bold]"),))
