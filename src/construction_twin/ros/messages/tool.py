"""Conversions between the messages of tool and engagement and the library's values; no parameters, no clock."""

from __future__ import annotations

import genpy

from construction_twin.core.errors import PayloadError
from construction_twin.core.reports import SwitchReport, SwitchState, ToolReport
from construction_twin.execution.engagement import Engagement
from construction_twin.execution.segment_run import ToolOrder
from construction_twin.msg import Engagement as EngagementMsg
from construction_twin.msg import Signal, ToolCommand, ToolState
from construction_twin.ros.messages.convert import trajectory_to_msg
from construction_twin.ros.messages.records import sentence_of, to_msg, with_sentences
from construction_twin.ros.transport.joint_stream import to_time


def tool_report_from_msg(msg: ToolState) -> ToolReport:
    """Return the report; PayloadError where lists that belong together differ in length, or a state is unknown."""
    together = (
        ("inputs", msg.inputs, msg.input_values),
        ("outputs", msg.outputs, msg.output_values),
        ("switches", msg.switch_ids, msg.switch_states),
        ("reasons of switches", msg.switch_ids, msg.switch_reasons),
    )
    for what, names, values in together:
        if len(names) != len(values):
            raise PayloadError("tool", f"{len(names)} {what} have {len(values)} values; expected as many")
    try:
        states = [SwitchState(state) for state in msg.switch_states]
    except ValueError as error:
        raise PayloadError("tool", f"{error}; expected the state of a switch as in ToolState.msg") from error
    return ToolReport(
        known=msg.known,
        tool=msg.tool,
        outputs=dict(zip(msg.outputs, map(bool, msg.output_values))),
        inputs=dict(zip(msg.inputs, map(bool, msg.input_values))),
        switches=dict(
            zip(msg.switch_ids, map(SwitchReport, states, (sentence_of(msg, why) for why in msg.switch_reasons)))
        ),
        reason=sentence_of(msg, msg.reason),
    )


def tool_report_to_msg(report: ToolReport, stamp: genpy.Time) -> ToolState:
    """Return the message."""
    message = ToolState(known=report.known, tool=report.tool, reason=report.reason)
    message.header.stamp = stamp
    message.outputs, message.output_values = list(report.outputs), list(report.outputs.values())
    message.inputs, message.input_values = list(report.inputs), list(report.inputs.values())
    message.switch_ids = list(report.switches)
    message.switch_states = [switch.state.value for switch in report.switches.values()]
    message.switch_reasons = [switch.reason for switch in report.switches.values()]
    return with_sentences(message, report)


def order_to_msg(order: ToolOrder) -> ToolCommand:
    """Return the message, without its stamp."""
    switch = order.switch
    if switch is None:
        return ToolCommand(verb=ToolCommand.VOID, plan_id=order.plan_id)
    armed = {"id": order.id, "plan_id": order.plan_id, "stamp": to_time(order.stamp)}
    return ToolCommand(verb=ToolCommand.ARM, output=switch.output, value=switch.value, **armed)


def engagement_to_msg(engagement: Engagement | None, tool: ToolReport) -> EngagementMsg:
    """Return the message, without its stamp; None: the arm is not engaged."""
    if engagement is None:
        return EngagementMsg(engaged=False)
    requires = engagement.requires(tool)
    message = EngagementMsg(
        engaged=True,
        **{name: getattr(engagement, name) for name in ("plan_id", "task", "segment", "reason")},
        trajectory=trajectory_to_msg(engagement.path.trajectory),
        end=engagement.path.end,
        requires=[to_msg(signal, Signal) for signal in requires],
        scenes=list(engagement.scenes_of(requires)),
    )
    return with_sentences(message, engagement.reason)
