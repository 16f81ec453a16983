"""What a work plan needs of the tool, compared with what is known of it. Pure."""

from __future__ import annotations

from construction_twin.core.reports import ToolReport
from construction_twin.core.sentences import Sentence
from construction_twin.robot.plan import Plan

#: Why there is none without a physical arm.
NO_ARM = Sentence("executor.tool.no_arm")


def awaited(report: ToolReport, plan: Plan) -> str:
    """Return what passes by itself and is against a work plan, as a clause: its tool is not known yet. "" when nothing is."""
    return report.unknown() if needs_tool(plan) and report.reason != NO_ARM else ""


def lacks(report: ToolReport, plan: Plan) -> str:
    """Return what a work plan needs of the tool and is not there, as a clause; "" when nothing is missing."""
    if not needs_tool(plan):
        return ""
    if problem := awaited(report, plan) or report.unknown():
        return problem
    if not report.tool:
        return Sentence("executor.tool.none")
    for segment in plan.segments:
        for switch in segment.switches:
            if switch.output not in report.outputs:
                return Sentence("executor.tool.no_output", tool=repr(report.tool), signal=repr(switch.output))
        confirmed = [signal for switch in segment.switches for signal in switch.confirm]
        for signal in (*segment.requires, *confirmed):
            if signal.name not in report.inputs:
                return Sentence("executor.tool.no_input", tool=repr(report.tool), signal=repr(signal.name))
    return ""


def needs_tool(plan: Plan) -> bool:
    """Return whether a plan switches the tool or requires something of its inputs."""
    return any(segment.switches or segment.requires for segment in plan.segments)
