"""A robot's state at one moment, and texts for people: plans, states and joint values, in deg and mm. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime

from construction_twin.core.reports import ExecutionReport, HoldReport, LinkReport, SyncReport
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.robot.description import RobotModel
from construction_twin.robot.plan import Plan
from construction_twin.robot.segments import Segment
from construction_twin.scene.objects import Scene
from construction_twin.scene.scene_change import SceneChange

#: Counters of the gateway that mean something was late or lost.
LATE = ("late_replies", "commands_late", "commands_lost", "cycles_without_command", "states_lost")
#: Longest name of a segment, an object or a signal in a table or picture; most segments of a work plan that a picture lists.
LONGEST_WORD, MOST_ROWS = 28, 12
#: States in which a plan could be approved.
READY = {"link": "ARMED", "sync": "IN_SYNC", "execution": "IDLE"}


@dataclass(frozen=True)
class Snapshot:
    """One robot at one moment; `silent`: for how long ``link``, ``sync``, ``execution`` have been silent [s], if too long."""

    robot: str
    joints: tuple[str, ...]
    linear: tuple[bool, ...]
    link: LinkReport | None = None
    sync: SyncReport | None = None
    execution: ExecutionReport | None = None
    hold: HoldReport | None = None
    plan: Plan | None = None
    silent: Mapping[str, float] = field(default_factory=dict)

    def not_ready(self) -> list[str]:
        """Return what keeps a plan from approval now, one sentence per reason; a twin alone needs no link."""
        lacking: list[str] = []
        for name, wanted in READY.items():
            facts = getattr(self, name)
            if facts is None:
                if name != "link":
                    lacking.append(f"{name} is silent; expected {wanted}")
            elif name in self.silent:
                seconds = self.silent[name]
                lacking.append(f"{name} has been silent for {seconds:.0f} s; expected {wanted}")
            elif facts.text != wanted:
                lacking.append(f"{name} is {facts.text}, expected {wanted}: {facts.reason}")
        return lacking


def hold_cause(hold: HoldReport | None) -> str:
    """Return what keeps the gate closed, and since when, by this machine's time of day; "" while nothing does."""
    if hold is None or not hold.cause:
        return ""
    since = f"{datetime.fromtimestamp(hold.since / NANOSECONDS):%H:%M:%S}"
    return Sentence("{reason}, since {since}", reason=hold.cause, since=since)


def joint_value(value: float, linear: bool, decimals: int = 3) -> str:
    """Return a joint's value [rad, or m] with its unit for people: deg, or mm."""
    return f"{value * 1e3:.{decimals}f} mm" if linear else f"{math.degrees(value):.{decimals}f} deg"


def plan_lines(plan: Plan, linear: Sequence[bool], changes: Sequence[SceneChange] = (), tool: str = "") -> list[str]:
    """Return the lines about a plan that a reviewer needs; `changes`: what a work plan's segments do to the scene.

    `tool`: the tip's pose at the goal, as the pendant shows it.
    """
    trajectory = plan.trajectory
    names = trajectory.joint_names
    values = map(joint_value, trajectory.positions[-1], linear)
    goal = ", ".join(f"{name} {value}" for name, value in zip(names, values))
    return [
        f"plan       {plan.id}",
        f"hash       {plan.hash}",
        f"asked by   {plan.source}, made by {plan.planner} in {plan.planning_time:.2f} s",
        f"duration   {trajectory.duration:.3f} s, {len(trajectory.times)} waypoints",
        f"clearance  {_closest(plan)}",
        f"limits     {_fractions(plan)}",
        f"goal       {goal}",
        *([f"tool       {tool} [mm, deg]"] if tool else []),
        *segment_lines(plan, changes),
    ]


def describe(plan: Plan, changes: Sequence[SceneChange] = (), problem: str = "") -> str:
    """Return the lines over a plan in rviz; `problem`: why the drawing may differ from what is approved."""
    lines = [f"{plan.trajectory.duration:.2f} s, {plan.planner} for {plan.source}"]
    if plan.segments:
        lines += [f"task {cut(plan.task)}, blue: engaged", *([f"LOOK TWICE: {problem}"] if problem else [])]
        lines += segment_lines(plan, changes)[1 : MOST_ROWS + 1]
    if len(plan.segments) > MOST_ROWS:
        lines.append(f"and {len(plan.segments) - MOST_ROWS} more")
    return "\n".join([*lines, f"closest: {_closest(plan)}", _fractions(plan)])


def _closest(plan: Plan) -> str:
    clearance = plan.report.clearance
    if not math.isfinite(clearance.distance):
        return "nothing to touch"
    return f"{clearance.distance * 1e3:.0f} mm, {closest_pair(clearance.between)}, after {clearance.time:.2f} s"


def caller_line(client: str, connected: bool | None) -> str:
    """Return the line about the program that sent the goal of a plan under review; None: unknown whether it is connected."""
    if connected is None:
        return f"caller     {client}: the node follow_joint_trajectory does not say whether it is still connected"
    if connected:
        return f"caller     {client} is connected and waits for the result"
    return f"caller     {client} is connected no more: nobody waits for the result, and it may not be wanted any longer"


def segment_lines(plan: Plan, changes: Sequence[SceneChange] = ()) -> list[str]:
    """Return a table of a work plan's segments: times, and what happens in each and at its end; nothing for others."""
    if not plan.segments:
        return []
    lines = [f"segments   {len(plan.segments)}, each from rest to rest and in the scene that the one before leaves"]
    width = max(len(cut(segment.name)) for segment in plan.segments)
    segment_changes = [*changes, *[None] * (len(plan.segments) - len(changes))]
    begin = 0.0
    for number, (segment, change) in enumerate(zip(plan.segments, segment_changes), 1):
        times = f"{begin:7.2f} to {segment.end:7.2f} s"
        words = segment_words(segment, change)
        lines.append(f"  {number:2d} {cut(segment.name):{width}} {times}  {'; '.join(words)}".rstrip())
        begin = segment.end
    return lines


def _fractions(plan: Plan) -> str:
    fractions, names = plan.report.usage, plan.trajectory.joint_names
    parts = []
    for quantity in ("velocity", "acceleration", "jerk"):
        values = getattr(fractions, quantity)
        if values:
            largest = max(range(len(values)), key=values.__getitem__)
            parts.append(f"{quantity} {values[largest]:.0%} ({names[largest]})")
    return f"largest fractions: {', '.join(parts)}" if parts else "not measured"


def scene_lines(scene: Scene) -> list[str]:
    """Return a scene's version and padding, then one line for each object: shape, size, where it stands, what it may touch."""
    lines = [f"version    {scene.hash[:12]}", f"padding    {scene.padding * 1e3:g} mm"]
    lines.append(f"objects    {len(scene.objects) or 'none'}")
    for item in scene.objects:
        size = " x ".join(f"{value:g}" if item.shape == "mesh" else f"{value * 1e3:g}" for value in item.size)
        place = " ".join(f"{value * 1e3:.0f}" for value in item.position)
        words = [f"{item.shape} {size} {'times' if item.shape == 'mesh' else 'mm'}", f"at {place} mm"]
        words += [f"carried by {item.link}"] if item.link else []
        words += [f"padding {item.padding * 1e3:g} mm more"] if item.padding else []
        words += [f"may touch {', '.join(item.touch)}"] if item.touch else []
        lines.append(f"  {item.name}: {', '.join(words)}")
    return lines


def status_lines(snapshot: Snapshot) -> list[str]:
    """Return the robot's states, one line each, and the plan under review."""
    lines = [f"robot      {snapshot.robot}"]
    if cause := hold_cause(snapshot.hold):
        lines.append(f"holds      {cause}")
    for name in ("link", "sync", "execution"):
        facts = getattr(snapshot, name)
        text = "no report" if facts is None else f"{facts.text}{reason_suffix(facts.reason)}"
        if facts is not None and name in snapshot.silent:
            text = f"silent for {snapshot.silent[name]:.0f} s; the last was {facts.text}"
        lines.append(f"{name:10} {text}")
    controller = controller_words(snapshot.link.gateway_counters) if snapshot.link is not None else ""
    if controller:
        lines.append(f"controller {controller}")
    if snapshot.link is not None and snapshot.link.not_checked:
        lines.append(f"bare PLC   {snapshot.link.responsible or 'no person'} is responsible; not checked:")
        lines += [f"           {sentence}" for sentence in snapshot.link.not_checked]
    if snapshot.execution is not None and snapshot.execution.plan_id:
        execution = snapshot.execution
        lines.append(f"last plan  {execution.plan_id}{reason_suffix(execution.outcome or 'under way')}")
    lines += work_lines(snapshot.execution)
    lines.append(f"review     {under_review(snapshot.plan)}")
    if snapshot.plan is not None and snapshot.execution is not None and snapshot.execution.approval_obstacle:
        lines.append(f"not yet    {snapshot.execution.approval_obstacle}")
    return lines


def watch_lines(snapshot: Snapshot) -> list[str]:
    """Return `status_lines`, each joint's error beside its threshold, and what was late or lost since the gateway began."""
    lines, sync = status_lines(snapshot), snapshot.sync
    if sync is None or "sync" in snapshot.silent or not len(sync.error) == len(sync.threshold) == len(snapshot.joints):
        lines.append("nothing is compared")
    else:
        for joint, linear, error, most in zip(snapshot.joints, snapshot.linear, sync.error, sync.threshold):
            mark = "" if abs(error) <= most else "  <"
            lines.append(f"{joint:10} {joint_value(error, linear, 4)} of {joint_value(most, linear, 4)}{mark}")
    if snapshot.link is not None:
        if snapshot.link.tool_pose:
            lines.append(f"tool pose  {snapshot.link.tool_pose}")
        counters = snapshot.link.gateway_counters
        # the gateway lists a counter from its first use on
        lines.append("; ".join(f"{name.replace('_', ' ')} {counters.get(name, '0')}" for name in LATE))
    return lines


def work_lines(execution: ExecutionReport | None) -> list[str]:
    """Return where a work plan is, one line, and that only the way back can be planned where that is so."""
    if execution is None:
        return []
    lines = []
    if execution.segment >= 0 and not execution.outcome:
        segment = f"{execution.segment + 1} {execution.segment_name}"
        segment = f"{segment}, at its end" if execution.at_boundary else segment
        segment = f"{segment}, waits for the scene to change as planned" if execution.wants_scene else segment
        lines.append(f"segment    {segment}")
    if execution.engaged:
        lines.append("engaged    only the way back along the executed path can be planned: twin back")
    return lines


def controller_words(values: Mapping[str, str]) -> str:
    """Return what the controller says on its optional channels, e.g. ``T1, program ACTIVE, override 100 %``; "" for nothing."""
    mode, program, override = (values.get(f"controller_{name}", "") for name in ("mode", "program", "override_percent"))
    words = [mode] if mode else []
    words += [f"program {program}"] if program else []
    words += [f"override {override} %"] if override else []
    return ", ".join(words)


def under_review(plan: Plan | None) -> str:
    """Return one line about the plan under review."""
    if plan is None:
        return "no plan waits"
    kind = f"work plan {plan.id} of {len(plan.segments)} segments and" if plan.segments else f"plan {plan.id} of"
    return f"{kind} {plan.trajectory.duration:.1f} s for {plan.source} waits for approval"


def waiting_plan(plan: Plan) -> str:
    """Return the short line about the plan under review that stands beside the marker."""
    clearance = plan.report.clearance.distance
    closest = f", closest {clearance * 1e3:.0f} mm" if math.isfinite(clearance) else ""
    return f"plan {plan.id[:8]} waits for approval: {plan.trajectory.duration:.1f} s{closest}"


def closest_pair(bodies: Sequence[str]) -> str:
    """Return the names of the two bodies that come closest, as a part of a sentence."""
    return f"{bodies[0]} to {bodies[1]}" if len(bodies) == 2 else "".join(bodies)


def reason_suffix(reason: str) -> str:
    """Return a reason as the rest of a line; nothing for none."""
    return f": {reason}" if reason else ""


def range_sentence(joint: str, value: float, robot: RobotModel) -> str:
    """Return how far a joint would have to go beyond its range, for people; `value` in [rad], [m]."""
    number = robot.joint_names.index(joint)
    linear = robot.linear[number]
    needed, lower, upper = (joint_value(each, linear, 1) for each in (value, robot.lower[number], robot.upper[number]))
    return f"{joint} would have to be {needed}; its range is {lower} to {upper}"


def segment_words(segment: Segment, change: SceneChange | None = None) -> list[str]:
    """Return a segment's particulars: engaged, requirements, switches at its end, change of the scene."""
    words: list[str] = ["engaged"] if segment.engaged else []
    if segment.requires:
        signals = ", ".join(_state(signal.name, signal.value) for signal in segment.requires)
        words.append(f"needs {signals}")
    if segment.switches:
        outputs = ", ".join(_state(switch.output, switch.value) for switch in segment.switches)
        words.append(f"then {outputs}")
    if segment.scene_after != segment.scene:
        words.append(change_words(change) if change else "the scene changes")
    return words


def change_words(change: SceneChange) -> str:
    """Return a change of the scene in words, with an element's name for its bodies ``<element>/0``, ..."""
    phrases: list[str] = []
    for verb, names in (
        ("carries", [item.name for item in change.put if item.link]),
        ("puts", [item.name for item in change.put if not item.link]),
        ("removes", [name for name in change.remove if name not in {item.name for item in change.put}]),
    ):
        things = list(dict.fromkeys(name.rsplit("/", 1)[0] for name in names))
        if things and verb == "removes":
            # what is gone is no longer kept clear of: the reviewer sees all of it
            phrases.append(f"removes {', '.join(things)}")
        elif things:
            first = cut(things[0])
            more = f"{first} and {len(things) - 1} more" if len(things) > 1 else first
            phrases.append(f"{verb} {more}")
    return ", ".join(phrases) or "the scene changes"


def cut(name: str) -> str:
    """Cut a name to the length that a picture can show."""
    return name if len(name) <= LONGEST_WORD else name[: LONGEST_WORD - 3] + "..."


def _state(name: str, value: bool) -> str:
    return f"{cut(name)} on" if value else f"{cut(name)} off"
