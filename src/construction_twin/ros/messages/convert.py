"""Trajectories, plans, segments, poses, tool and engagement as messages, and back; without loss. No parameters, no clock."""

from __future__ import annotations

import math
from collections.abc import Sequence

import genpy
import numpy as np
from geometry_msgs.msg import Point, Quaternion, Transform
from geometry_msgs.msg import Pose as PoseMsg
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from construction_twin.core.errors import PayloadError
from construction_twin.core.freshness import parse_moment
from construction_twin.core.reports import SwitchReport, SwitchState, ToolReport
from construction_twin.core.units import NANOSECONDS
from construction_twin.execution.engagement import Engagement
from construction_twin.execution.segment_run import ToolOrder
from construction_twin.kinematics.chain import Pose
from construction_twin.msg import Engagement as EngagementMsg
from construction_twin.msg import Plan as PlanMsg
from construction_twin.msg import Segment as SegmentMsg
from construction_twin.msg import Signal as SignalMsg
from construction_twin.msg import ToolCommand, ToolState, ToolSwitch
from construction_twin.msg import WorkSegment as WorkSegmentMsg
from construction_twin.planning.work_segment import WorkSegment
from construction_twin.robot.frames import quaternion_to_rotation, rotation_to_quaternion
from construction_twin.robot.motion_errors import TrajectoryError
from construction_twin.robot.plan import Clearance, LimitUsage, Plan, PlanReport
from construction_twin.robot.segments import Segment, Signal, Switch
from construction_twin.robot.trajectory import Trajectory
from construction_twin.ros.messages.records import from_msg, sentence_of, to_msg, with_sentences
from construction_twin.ros.messages.scene_convert import object_from_msg, object_to_msg
from construction_twin.ros.transport.joint_stream import to_time
from construction_twin.scene.scene_change import SceneChange

#: What a plan and its message have alike.
_ALIKE = ("id", "hash", "source", "planner", "scene", "planning_time", "task")


def trajectory_to_msg(trajectory: Trajectory) -> JointTrajectory:
    """Return the message; its header is left empty: a trajectory has no start time of its own."""
    rows = zip(trajectory.times, trajectory.positions, trajectory.velocities, trajectory.accelerations)
    return JointTrajectory(
        joint_names=list(trajectory.joint_names),
        points=[
            JointTrajectoryPoint(
                positions=position.tolist(),
                velocities=velocity.tolist(),
                accelerations=acceleration.tolist(),
                time_from_start=genpy.Duration(0, round(time * 1e9)),
            )
            for time, position, velocity, acceleration in rows
        ],
    )


def trajectory_from_msg(msg: JointTrajectory) -> Trajectory:
    """Return the trajectory; TrajectoryError where it is none, or has no velocities or accelerations."""
    return Trajectory(
        joint_names=tuple(msg.joint_names),
        times=np.array([point.time_from_start.to_nsec() / NANOSECONDS for point in msg.points]),
        positions=[point.positions for point in msg.points],  # type: ignore[arg-type]  # rows may differ in length; Trajectory checks
        velocities=[point.velocities for point in msg.points],  # type: ignore[arg-type]  # rows may differ in length; Trajectory checks
        accelerations=[point.accelerations for point in msg.points],  # type: ignore[arg-type]  # rows may differ in length; Trajectory checks
    )


def plan_to_msg(plan: Plan, frame_id: str, tool_path: np.ndarray, changes: Sequence[SceneChange] = ()) -> PlanMsg:
    """Return the message.

    Args:
        frame_id: tf frame of the robot's base, which `tool_path`, shape (k, 3) [m], is in.
        changes: What each segment of a work plan does to the scene, for displays.
    """
    clearance, usage = plan.report.clearance, plan.report.usage
    segment_changes = changes or [SceneChange()] * len(plan.segments)
    msg = PlanMsg(
        **{name: getattr(plan, name) for name in _ALIKE},
        asked=str(plan.asked),
        duration=plan.trajectory.duration,
        recheck_time=plan.report.recheck_time,
        trajectory=trajectory_to_msg(plan.trajectory),
        tool_path=[Point(*position) for position in np.asarray(tool_path).tolist()],
        clearance=clearance.distance,
        clearance_time=clearance.time,
        clearance_between=list(clearance.between),
        clearance_point=Point(*clearance.point),
        velocity_use=list(usage.velocity),
        acceleration_use=list(usage.acceleration),
        jerk_use=list(usage.jerk),
        segments=[
            segment_to_msg(segment, change) for segment, change in zip(plan.segments, segment_changes, strict=True)
        ],
    )
    msg.header.frame_id = frame_id
    return msg


def plan_from_msg(msg: PlanMsg) -> Plan:
    """Return the plan; TrajectoryError or PayloadError where its trajectory, hash, measurements or moment are none."""
    return Plan(
        **{name: getattr(msg, name) for name in _ALIKE},
        asked=parse_moment(msg.asked),
        trajectory=trajectory_from_msg(msg.trajectory),
        report=_report_from_msg(msg),
        segments=tuple(from_msg(Segment, segment) for segment in msg.segments),
    )


def segment_to_msg(segment: Segment, change: SceneChange = SceneChange()) -> SegmentMsg:
    """Return the message; `change` leads to the scene after it."""
    msg = to_msg(segment, SegmentMsg)
    _add_change(msg, change)
    return msg


def work_segment_to_msg(segment: WorkSegment) -> WorkSegmentMsg:
    """Return the message."""
    msg = WorkSegmentMsg(name=segment.name, engaged=segment.engaged, trajectory=trajectory_to_msg(segment.trajectory))
    msg.requires = [to_msg(signal, SignalMsg) for signal in segment.requires]
    msg.switches = [to_msg(switch, ToolSwitch) for switch in segment.switches]
    _add_change(msg, segment.change)
    return msg


def work_segment_from_msg(msg: WorkSegmentMsg) -> WorkSegment:
    """Return the segment; TrajectoryError or SceneError where it is none."""
    return WorkSegment(
        msg.name,
        trajectory_from_msg(msg.trajectory),
        msg.engaged,
        tuple(from_msg(Signal, signal) for signal in msg.requires),
        tuple(from_msg(Switch, switch) for switch in msg.switches),
        change_from_msg(msg),
    )


def _add_change(msg: SegmentMsg | WorkSegmentMsg, change: SceneChange) -> None:
    msg.put, msg.remove = list(map(object_to_msg, change.put)), list(change.remove)


def change_from_msg(msg: SegmentMsg | WorkSegmentMsg) -> SceneChange:
    """Return what a segment does to the scene; SceneError where an object is none."""
    return SceneChange(tuple(map(object_from_msg, msg.put)), tuple(msg.remove))


def _report_from_msg(msg: PlanMsg) -> PlanReport:
    point = msg.clearance_point
    measured = (msg.clearance_time, point.x, point.y, point.z, *msg.velocity_use, *msg.acceleration_use, *msg.jerk_use)
    # an infinite clearance is valid: there is nothing to touch
    if math.isnan(msg.clearance) or not all(map(math.isfinite, measured)):
        raise TrajectoryError(
            f"plan {msg.id} was measured as clearance {msg.clearance} at {msg.clearance_time} s, limit "
            f"usage {[*measured[4:]]}; expected numbers"
        )
    return PlanReport(
        Clearance(msg.clearance, tuple(msg.clearance_between), (point.x, point.y, point.z), msg.clearance_time),
        LimitUsage(tuple(msg.velocity_use), tuple(msg.acceleration_use), tuple(msg.jerk_use)),
        msg.recheck_time,
    )


def pose_from_msg(msg: PoseMsg) -> Pose:
    """Return the pose; KinematicsError where its orientation is no unit quaternion within 1e-3."""
    return Pose(_vector(msg.position), quaternion_to_rotation(_quaternion(msg.orientation)))


def pose_to_msg(pose: Pose) -> PoseMsg:
    """Return the message of a pose."""
    return PoseMsg(Point(*map(float, pose.position)), Quaternion(*rotation_to_quaternion(pose.rotation).tolist()))


def pose_from_transform_msg(msg: Transform) -> Pose:
    """Return the pose that a transform gives its child frame in its parent frame; raises like `pose_from_msg`."""
    return Pose(_vector(msg.translation), quaternion_to_rotation(_quaternion(msg.rotation)))


def _vector(msg) -> np.ndarray:
    return np.array((msg.x, msg.y, msg.z))


def _quaternion(msg) -> tuple[float, float, float, float]:
    return msg.x, msg.y, msg.z, msg.w


def tool_report_from_msg(msg: ToolState) -> ToolReport:
    """Return the report; PayloadError where lists that belong together differ in length, or a state is unknown."""
    try:
        rows = zip(msg.switch_ids, msg.switch_states, msg.switch_reasons, strict=True)
        return ToolReport(
            known=msg.known,
            tool=msg.tool,
            outputs=dict(zip(msg.outputs, map(bool, msg.output_values), strict=True)),
            inputs=dict(zip(msg.inputs, map(bool, msg.input_values), strict=True)),
            switches={name: SwitchReport(SwitchState(state), sentence_of(msg, why)) for name, state, why in rows},
            reason=sentence_of(msg, msg.reason),
        )
    except ValueError as error:
        raise PayloadError("tool", f"{error}; expected lists of one length, and states as in ToolState.msg") from error


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
        requires=[to_msg(signal, SignalMsg) for signal in requires],
        scenes=list(engagement.scenes_of(requires)),
    )
    return with_sentences(message, engagement.reason)
