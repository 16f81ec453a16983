"""A work plan: motions made elsewhere, joined at rest to one trajectory and checked each in the scene of its execution.

Whoever made the motions is not trusted: limits and contacts are checked as those of any plan.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.limits import OUTSIDE
from construction_twin.core.sentences import Quantity, Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.planning.limit_usage import SAME_POINT
from construction_twin.planning.planner import PlanRequest
from construction_twin.planning.recheck import CollisionError, check_limits, recheck
from construction_twin.planning.request_limits import PlanBounds
from construction_twin.planning.waypoints import AT_REST, START_TOLERANCE_M, START_TOLERANCE_RAD
from construction_twin.planning.work_segment import WorkSegment
from construction_twin.robot.description import JointValues, RobotModel
from construction_twin.robot.motion_errors import PlanningError, TrajectoryError
from construction_twin.robot.plan import LimitUsage, Plan, PlanReport
from construction_twin.robot.segments import Segment, Signal
from construction_twin.robot.trajectory import Trajectory
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.same_space import fills_same_space
from construction_twin.scene.scene_change import SceneChange


class SegmentError(PlanningError):
    """A segment makes a work plan invalid; `number` from 0, in the sentence from 1."""

    def __init__(self, number: int, name: str, cause: ConstructionTwinError):
        self.number, self.name, self.cause = number, name, cause
        super().__init__(
            Sentence("segment {number} ({name}): {cause}", number=number + 1, name=repr(name[:80]), cause=str(cause))
        )


#: Name of the planner in a work plan.
WORK = "work"
#: Largest work plan: segments; switches of a segment, as many as a tool has outputs; signals of each; objects that one change of
#: the scene puts or removes; characters of a name.
MOST_SEGMENTS, MOST_SWITCHES, MOST_SIGNALS, MOST_OBJECTS, LONGEST_NAME = 200, 8, 64, 2000, 200
#: Longest time in which a switch may be confirmed [s].
LONGEST_TIMEOUT = 600.0
#: What is gripped or put down may lie this far from where it was [m], [rad].
CARRIED_DISTANCE, CARRIED_ANGLE = 2e-3, float(np.radians(0.2))


def plan_work(
    task: str,
    segments: Sequence[WorkSegment],
    present: JointValues,
    request: PlanRequest,
    world: CollisionWorld,
    bounds: PlanBounds,
    clock: Callable[[], float],
    planner: str = WORK,
) -> Plan:
    """Join segments to a plan and check each in its scene, limits at every 4 ms, contacts between these samples too.

    The first segment begins at `present`, shape (n,), within `START_TOLERANCE_RAD` or `_M`; what is left of the difference fades
    away during the segment. Duration, scales and waypoints of `request` are not used. SegmentError names the segment.
    """
    began = clock()
    _check_counts(task, segments, bounds)
    robot = world.robot
    parts = _parts(segments, present, robot)
    trajectory, ends = joined(parts)
    joining = clock() - began
    reports, checked = [], []
    first_scene = world.scene.hash
    for number, (item, part, end) in enumerate(zip(segments, parts, ends)):
        with in_segment(number, item.name):
            before = world
            reports.append(recheck(part, robot, before, clock))
            world = _after(before, item.change)
            if world is not before:
                _check_end(part, world)
                _check_carried(part, before, world)
        checked.append(
            Segment(
                item.name, end, item.engaged, item.requires, item.switches, before.scene.hash, world.scene.hash
            )
        )  # fmt: skip
    report = _merged(reports, ends, check_limits(trajectory, robot))
    return request.plan(planner, joining, trajectory, report, first_scene, task, tuple(checked))


@contextmanager
def in_segment(number: int, name: str) -> Iterator[None]:
    """Let every error of the library that is raised inside name the segment (`SegmentError`)."""
    try:
        yield
    except SegmentError:
        raise
    except ConstructionTwinError as error:
        raise SegmentError(number, name, error) from error


# -- what is asked for


def _check_counts(task: str, segments: Sequence[WorkSegment], bounds: PlanBounds) -> None:
    """Check everything that costs nothing, sizes first."""
    if not task.strip():
        raise PlanningError("a work plan is asked for without a task; say which task it carries out")
    _check_name("the task", task)
    if not 0 < len(segments) <= MOST_SEGMENTS:
        raise PlanningError(f"a work plan of {len(segments)} segments is asked for; expected 1 to {MOST_SEGMENTS}")
    duration = sum(item.trajectory.duration for item in segments)
    bounds.check(duration, sum(len(item.trajectory.times) for item in segments))
    for number, item in enumerate(segments):
        with in_segment(number, item.name):
            _check_segment(item)


def _check_segment(item: WorkSegment) -> None:
    _check_name("the segment", item.name)
    counts = {
        "required signals": (len(item.requires), MOST_SIGNALS),
        "switches": (len(item.switches), MOST_SWITCHES),
        "signals that confirm a switch": (max((len(each.confirm) for each in item.switches), default=0), MOST_SIGNALS),
        "objects to put": (len(item.change.put), MOST_OBJECTS),
        "objects to remove": (len(item.change.remove), MOST_OBJECTS),
    }
    for what, (count, most) in counts.items():
        if count > most:
            raise PlanningError(f"it has {count} {what}; expected at most {most}")
    _check_signals("its required inputs", item.requires)
    _check_once("its switched outputs", [switch.output for switch in item.switches])
    if item.switches and not item.engaged:
        outputs = ", ".join(switch.output for switch in item.switches)
        raise PlanningError(f"it switches {outputs} at its end and is not engaged; expected an engaged segment")
    for switch in item.switches:
        _check_name("an output", switch.output)
        _check_signals(f"what confirms {switch.output}", switch.confirm)
        if not 0.0 < switch.timeout <= LONGEST_TIMEOUT:
            expected = f"expected above 0, at most {LONGEST_TIMEOUT:g} s"
            raise PlanningError(f"{switch.output} has {switch.timeout} s to be confirmed; {expected}")
        if set(switch.confirm) <= set(item.requires):
            raise PlanningError(
                f"what confirms {switch.output} is required before it; expected an input that must change"
            )


def _check_name(what: str, name: str) -> None:
    if not name.strip() or len(name) > LONGEST_NAME or not name.isprintable():
        expected = f"expected 1 to {LONGEST_NAME} characters in one line"
        raise PlanningError(f"the name of {what} is {name[:LONGEST_NAME]!r}; {expected}")


def _check_signals(what: str, signals: Sequence[Signal]) -> None:
    for signal in signals:
        _check_name("an input", signal.name)
    _check_once(what, [signal.name for signal in signals])


def _check_once(what: str, names: Sequence[str]) -> None:
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise PlanningError(f"{what} name {', '.join(map(repr, twice))} more than once; expected each once")


# -- one trajectory


def _parts(segments: Sequence[WorkSegment], present: JointValues, robot: RobotModel) -> list[Trajectory]:
    """Return the segments' trajectories, each beginning exactly where the one before ends."""
    parts: list[Trajectory] = []
    begin = np.array(present, dtype=float)
    for number, item in enumerate(segments):
        with in_segment(number, item.name):
            robot.check_range(begin, (0.0, 0.0) if number else OUTSIDE)
            parts.append(_from_rest_to_rest(item.trajectory, begin, robot, at_present=number == 0))
            begin = parts[-1].positions[-1]
    return parts


def _from_rest_to_rest(trajectory: Trajectory, begin: np.ndarray, robot: RobotModel, at_present: bool) -> Trajectory:
    if trajectory.joint_names != tuple(robot.joint_names):
        found, expected = ", ".join(trajectory.joint_names), ", ".join(robot.joint_names)
        raise TrajectoryError(f"its joints are {found}; expected {expected}, in this order")
    velocities, accelerations = trajectory.velocities.copy(), trajectory.accelerations.copy()
    for name, unit, values in (("velocity", "/s", velocities), ("acceleration", "/s^2", accelerations)):
        for row, where in ((0, "begins"), (-1, "ends")):
            joint = int(np.argmax(np.abs(values[row])))
            if abs(values[row, joint]) > AT_REST:
                moves = Quantity(float(values[row, joint]), ("m" if robot.linear[joint] else "rad") + unit)
                raise TrajectoryError(
                    f"it {where} with a {name} of {moves} of {robot.joint_names[joint]}; expected rest at both ends"
                )
            values[row] = 0.0
    missing = begin - trajectory.positions[0]
    _check_begin(missing, robot, at_present)
    positions = trajectory.positions.copy()
    if at_present and missing.any():
        # the quintic from 1 to 0 added to quintics: the result is exact, and at rest at both ends as they are
        x = (trajectory.times / trajectory.duration)[:, None]
        positions += missing * (1.0 - x**3 * (10.0 - 15.0 * x + 6.0 * x**2))
        velocities -= missing * 30.0 * x**2 * (1.0 - x) ** 2 / trajectory.duration
        accelerations -= missing * 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / trajectory.duration**2
        positions[-1] = trajectory.positions[-1]
        velocities[[0, -1]] = accelerations[[0, -1]] = 0.0
    positions[0] = begin
    return Trajectory(trajectory.joint_names, trajectory.times, positions, velocities, accelerations)


def _check_begin(missing: np.ndarray, robot: RobotModel, at_present: bool) -> None:
    start_tolerance = np.where(robot.linear, START_TOLERANCE_M, START_TOLERANCE_RAD)
    tolerance = start_tolerance if at_present else np.full(len(missing), SAME_POINT)
    if np.all(np.abs(missing) <= tolerance):
        return
    joint = int(np.argmax(np.abs(missing) / tolerance))
    unit = "m" if robot.linear[joint] else "rad"
    where = "where the segment before it ends; expected the same pose"
    if at_present:
        within = Quantity(float(tolerance[joint]), unit)
        where = f"where the arm is; expected within {within}, plan the task again from there"
    away = Quantity(float(abs(missing[joint])), unit)
    raise TrajectoryError(f"it begins {away} of {robot.joint_names[joint]} away from {where}")


def joined(parts: Sequence[Trajectory]) -> tuple[Trajectory, list[float]]:
    """Join trajectories of which each begins where the one before ends; return it, and the time of each one's end in it [s]."""
    # whole nanoseconds are added, so that no end depends on how sums of seconds are rounded
    spans = [np.round(part.times * NANOSECONDS).astype(np.int64) for part in parts]
    begins = np.concatenate(([0], np.cumsum([span[-1] for span in spans])))
    rows = [slice(0 if number == 0 else 1, None) for number in range(len(parts))]
    times = np.concatenate([(begin + span)[row] for begin, span, row in zip(begins, spans, rows)]) / NANOSECONDS
    columns = [
        np.concatenate([getattr(part, name)[row] for part, row in zip(parts, rows)])
        for name in ("positions", "velocities", "accelerations")
    ]
    trajectory = Trajectory(parts[0].joint_names, times, *columns)
    last = np.cumsum([len(part.times) - 1 for part in parts])
    return trajectory, trajectory.times[last].tolist()


# -- scenes and measurements


def _after(world: CollisionWorld, change: SceneChange) -> CollisionWorld:
    """Return the world after a change of the scene; the same one where that changes nothing."""
    scene = change.apply(world.scene)
    return world if scene.hash == world.scene.hash else world.with_scene(scene)


def _check_end(part: Trajectory, world: CollisionWorld) -> None:
    """Check that nothing touches where a segment ends, once the scene has changed: also after the last one."""
    contact = world.contact(part.positions[-1])
    if contact is not None:
        raise CollisionError(contact.between, Sentence("at its end, after its change of the scene"))


def _check_carried(part: Trajectory, before: CollisionWorld, after: CollisionWorld) -> None:
    """Check that what another link carries than before is the same thing, where it was: a change of the scene moves nothing.

    A symmetric thing may be told as turned: what counts is the space that it fills.
    """
    q = part.positions[-1]
    objects = {item.name: item for item in before.scene.objects}
    pairs = [(objects[item.name], item) for item in after.scene.objects if item.name in objects]
    pairs = [(was, item) for was, item in pairs if was.link != item.link]
    left = [was for was, _ in pairs]
    for was, item in pairs:
        one, other = before.object_pose(q, was.name), after.object_pose(q, item.name)
        moved = float(np.linalg.norm(other.position - one.position))
        turn = one.rotation.T @ other.rotation
        # of small angles this is exact, which the arc cosine of the trace is not
        turned = 2.0 * float(np.arcsin(min(1.0, np.linalg.norm(turn - np.eye(3)) / np.sqrt(8.0))))
        same_shape = (was.shape, was.size, was.mesh_digest) == (item.shape, item.size, item.mesh_digest)
        if same_shape and moved <= CARRIED_DISTANCE and turned <= CARRIED_ANGLE and was in left:
            left.remove(was)
            continue
        # a piece of a symmetric thing that was turned may be where another piece was
        for earlier in left:
            if fills_same_space(earlier, before.object_pose(q, earlier.name), item, other, CARRIED_DISTANCE):
                left.remove(earlier)
                break
        else:
            if not same_shape:
                raise PlanningError(f"{item.name!r} has another shape or size once another link carries it")
            away, most = (Quantity(moved, "m"), Quantity(turned, "rad")), (CARRIED_DISTANCE, CARRIED_ANGLE)
            raise PlanningError(
                f"{item.name!r} would be {away[0]} and {away[1]} from where it was once {item.link or 'nothing'} carries it; "
                f"expected at most {Quantity(most[0], 'm')} and {Quantity(most[1], 'rad')}"
            )


def _merged(reports: Sequence[PlanReport], ends: Sequence[float], whole: LimitUsage) -> PlanReport:
    """Return what was measured on all segments: the smallest clearance at its time in the whole, the largest use of each limit."""
    begins = [0.0, *ends[:-1]]
    worst = min(range(len(reports)), key=lambda number: reports[number].clearance.distance)
    clearance = reports[worst].clearance
    usages = [report.usage for report in reports] + [whole]
    largest = (
        tuple(np.max([getattr(usage, name) for usage in usages], axis=0).tolist())
        for name in ("velocity", "acceleration", "jerk")
    )
    return PlanReport(
        dataclasses.replace(clearance, time=begins[worst] + clearance.time),
        LimitUsage(*largest),
        sum(report.recheck_time for report in reports),
    )
