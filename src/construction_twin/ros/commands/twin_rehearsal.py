"""The command `twin rehearsal`: what the rehearsal of the newest plan has found."""

from __future__ import annotations

import contextlib

import rospy

from construction_twin.core.errors import ConstructionTwinError, SilenceError
from construction_twin.evaluation.tables import table_console
from construction_twin.msg import Rehearsal
from construction_twin.physics.report import PASSED, RehearsalReport, is_whole
from construction_twin.ros.messages.records import from_msg
from construction_twin.ros.shared.master import expect_publisher
from construction_twin.views.arguments import Exit
from construction_twin.views.rehearsal_table import rehearsal_table


def show_rehearsal(namespace: str, timeout: float) -> Exit:
    """Show it; a rehearsal that did not pass is told by the exit code.

    Args:
        namespace: Of the robot, absolute.
        timeout: Longest wait for the first result [s].
    """
    topic = f"{namespace}/rehearsal"
    expect_publisher(topic)
    try:
        report = _read(rospy.wait_for_message(topic, Rehearsal, timeout))
    except rospy.ROSException as error:
        raise SilenceError(
            topic,
            "no plan was rehearsed yet",
            "have a motion planned, or see on /diagnostics why there is no rehearsal",
        ) from error
    _print(report)
    return Exit.DONE if report.state == PASSED else Exit.REFUSED


def print_rehearsal(namespace: str, plan_id: str, plan_hash: str, timeout: float) -> str:
    """Print what the rehearsal of a plan has found, or that there is none; return the result's hash, "" where there is none.

    Args:
        namespace: Of the robot, absolute.
        timeout: Longest wait for what is latched [s].
    """
    report = None
    with contextlib.suppress(rospy.ROSException):  # nothing is latched: no plan was rehearsed yet
        report = _read(rospy.wait_for_message(f"{namespace}/rehearsal", Rehearsal, timeout))
    if report is None or (report.plan_id, report.plan_hash) != (plan_id, plan_hash):
        print(f"plan {plan_id} was not rehearsed yet, and it must be")
        return ""
    _print(report)
    return report.hash


def _read(message: Rehearsal) -> RehearsalReport:
    """Return the result; ConstructionTwinError for one whose hash is not its own."""
    report = from_msg(RehearsalReport, message)
    if not is_whole(report):
        raise ConstructionTwinError(f"the rehearsal of plan {report.plan_id!r} is not what its hash says")
    return report


def _print(report: RehearsalReport) -> None:
    table_console().print(rehearsal_table(report))
