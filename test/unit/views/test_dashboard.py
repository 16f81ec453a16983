"""What `twin watch` shows of a snapshot."""

from __future__ import annotations

from scene_samples import kr120

from construction_twin.core.reports import LinkReport, SyncReport
from construction_twin.views.texts import Snapshot, watch_lines


def shown(**changes) -> str:
    robot = kr120()
    return "\n".join(watch_lines(Snapshot("kr120", 105.0, robot.joint_names, robot.linear, **changes)))


def test_a_report_that_fell_silent_is_not_shown_as_the_present():
    sync = SyncReport("IN_SYNC", "the poses agree", "replan", "aligned", (0.001,) * 6, (0.01,) * 6)
    text = shown(link=LinkReport("ARMED", "commands flow"), sync=sync, silent={"sync": 4.2, "link": 7.0})
    assert "silent for 4 s; the last was IN_SYNC" in text and "silent for 7 s; the last was ARMED" in text
    assert "nothing is compared" in text and "joint_a1" not in text


def test_a_joint_over_its_threshold_is_marked_and_what_was_late_is_counted():
    sync = SyncReport("HOLDING", "", "replan", "aligned", (0.001, 0.02, 0.0, 0.0, 0.0, 0.0), (0.01,) * 6)
    text = shown(link=LinkReport("ARMED", "", gateway_counters={"late_replies": "3"}), sync=sync)
    assert "joint_a1   0.0573 deg of 0.5730 deg\n" in text and "joint_a2   1.1459 deg of 0.5730 deg  <\n" in text
    assert "late replies 3; commands late 0" in text
