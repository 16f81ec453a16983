"""Exceptions of kinematics, scene and planning: a branch of the tree in `errors`, kept apart because the gateway needs none of it.

Each message is the sentence of a key, with the error's data as its values: what, where, the value, what was expected, what to do.
"""

from __future__ import annotations

from collections.abc import Sequence

from construction_twin.core.errors import ConstructionTwinError, found_and_expected
from construction_twin.core.sentences import Quantity, Sentence, both


class KinematicsError(ConstructionTwinError):
    """A pose has no usable joint solution, or joints have no usable pose."""


class UnreachableError(KinematicsError):
    """The target lies outside of what the arm reaches, whatever its joint ranges.

    Attributes:
        missing: By how much [m], > 0: how far the target has to move, at least.
        too_close: False: the target is too far away. True: too close to the arm's base to fold the arm to it.
    """

    def __init__(self, missing: float, too_close: bool = False):
        self.missing = missing
        self.too_close = too_close
        mm = missing * 1e3
        super().__init__(
            Sentence("the target is too close to the arm by {mm:g} mm; move it away from the base", mm=mm)
            if too_close
            else Sentence("the target is out of the arm's reach by {mm:g} mm; move it closer to the base", mm=mm)
        )


class JointRangeError(KinematicsError):
    """A joint position lies outside its range.

    Attributes:
        value, lower, upper: [rad] ([m] for a prismatic joint).
    """

    def __init__(self, joint: str, value: float, lower: float, upper: float, linear: bool = False):
        self.joint, self.value, self.lower, self.upper, self.linear = joint, value, lower, upper, linear
        found, low, high = (Quantity(number, "m" if linear else "rad") for number in (value, lower, upper))
        super().__init__(self._sentence(joint=joint, value=found, lower=low, upper=high))

    def _sentence(self, **values: str | Quantity) -> Sentence:
        return Sentence("{joint} is {value}, outside its range {lower} to {upper}", **values)


class PoseRangeError(JointRangeError):
    """The target could be reached, but only with a joint outside its range.

    Attributes:
        joint: The joint that prevents it, in the solution that is out of range by least.
        value, lower, upper: What it would have to be, and its range [rad] ([m] for a prismatic joint).
    """


class PositionRangeError(PoseRangeError):
    """The wrist cannot get where the target needs it within the joint ranges."""

    def _sentence(self, **values: str | Quantity) -> Sentence:
        return Sentence(
            "the target's position needs {joint} at {value}, outside its range {lower} to {upper}; move the target",
            **values,
        )


class OrientationError(PoseRangeError):
    """The target's position can be reached, but not with its orientation within the joint ranges."""

    def _sentence(self, **values: str | Quantity) -> Sentence:
        return Sentence(
            "the target's orientation needs {joint} at {value}, outside its range {lower} to {upper}; turn the target",
            **values,
        )


class BranchError(KinematicsError):
    """A configuration of the arm (shoulder, elbow, wrist) is unknown, or does not exist for this arm or target.

    Attributes:
        available: What could be chosen instead; () where nothing can.
    """

    def __init__(self, asked: str, available: tuple[str, ...], problem: str):
        self.available = available
        choose = f"choose one of: {', '.join(available)}" if available else "leave the choice open"
        super().__init__(f"configuration {asked!r} {problem}; {choose}")


class UnreachableOrientationError(KinematicsError):
    """The target's position can be reached, but not with its orientation, whatever the joint ranges."""

    def __init__(self) -> None:
        super().__init__(
            Sentence("the target's position can be reached, but not with its orientation: turn the target")
        )


class NotFoundError(KinematicsError):
    """No joint solution was found in the time given, which does not prove that there is none.

    Attributes:
        budget_s: The time given [s].
        residual_m, residual_rad: Position and orientation error of the best attempt within the ranges; inf without any.
        hint: What the search saw besides: part of a sentence, or "".
    """

    def __init__(self, tried: int, budget_s: float, residual_m: float, residual_rad: float, hint: str = ""):
        self.tried, self.budget_s, self.hint = tried, budget_s, hint
        self.residual_m, self.residual_rad = residual_m, residual_rad
        away, turned, best = Quantity(residual_m, "m"), Quantity(residual_rad, "rad"), ""
        if residual_m < 1e3:
            best = Sentence("the best attempt was {away:.3} and {turned:.4} away", away=away, turned=turned)
        super().__init__(
            Sentence(
                "no joint solution was found in the time given ({budget:.3g} s, {tried} starts); it may still be reachable: {seen}",
                budget=budget_s,
                tried=tried,
                seen=both(best, hint, Sentence("allow more time or turn the target")),
            )
        )


class SceneError(ConstructionTwinError):
    """The scene, or a change to it, does not make sense; the scene stays as it was.

    Attributes:
        where: What is wrong: an object's property (``object 'wall' size``), a name, a file.
    """

    def __init__(self, where: str, value: object, expected: str):
        self.where, self.value, self.expected = where, value, expected
        super().__init__(found_and_expected(where, value, expected))


class PlanningError(ConstructionTwinError):
    """A motion could not be planned or timed."""


class NoPathError(PlanningError):
    """The planner found no path in its time budget.

    Attributes:
        budget: How long was tried [s].
    """

    def __init__(self, planner: str, budget: float):
        self.planner = planner
        self.budget = budget
        super().__init__(
            Sentence(
                "{planner} found no path within {budget:.3g} s; allow more time or choose another goal",
                planner=planner,
                budget=budget,
            )
        )


class CollisionError(PlanningError):
    """Two bodies that must not touch do.

    Attributes:
        between: Length 2. Names of the two: a link or a carried object first, then a link or an object of the scene.
        where: ``the start``, ``the goal``, ``at 1.204 s``, ...
        time: In a motion [s]; None where there is none.
    """

    def __init__(self, between: tuple[str, str], where: str, time: float | None = None):
        self.between = tuple(between)
        self.where, self.time = where, time
        first, second = between
        super().__init__(self._sentence(first=first, second=second, where=where))

    def _sentence(self, **values: str) -> Sentence:
        return Sentence(
            "{first} touches {second} ({where}), or comes closer than the padding; expected no contact, "
            "choose another pose or change the scene",
            **values,
        )


class RetimedCollisionError(CollisionError):
    """A motion whose times were replaced touches something; `where` names points of the sender, who knows no others.

    Attributes:
        lines_free: Nothing touches on the straight lines between the points.
    """

    def __init__(self, between: tuple[str, str], where: str, why: str, lines_free: bool):
        self.why, self.lines_free = why, lines_free
        super().__init__(between, where)

    def _sentence(self, **values: str) -> Sentence:
        values["why"] = self.why
        if self.lines_free:
            return Sentence(
                "{first} touches {second} ({where}), or comes closer than the padding, although the straight lines between the "
                "points are free; use more points there. The motion was timed anew, because {why}",
                **values,
            )
        return Sentence(
            "{first} touches {second} ({where}, on the straight line), or comes closer than the padding; choose another way. "
            "The times are not the reason: the motion was timed anew, because {why}",
            **values,
        )


class DurationError(PlanningError):
    """The requested duration is shorter than the limits allow.

    Attributes:
        requested, minimum: [s]
    """

    def __init__(self, requested: float, minimum: float):
        self.requested = requested
        self.minimum = minimum
        super().__init__(
            f"a duration of {requested:.3f} s breaks the joint limits; the shortest possible is {minimum:.3f} s"
        )


class PlanSizeError(PlanningError):
    """A plan would be larger than this planner makes.

    Attributes:
        quantity: ``duration`` [s], ``waypoints`` or ``length`` of the tool's path [m].
    """

    _OF = {
        "duration": ("duration", "ask for a faster or shorter motion"),
        "waypoints": ("waypoints", "ask for fewer, or for a faster or shorter motion"),
        "length": ("length of the tool's path", "divide it into several"),
    }

    def __init__(self, quantity: str, value: float, limit: float):
        self.quantity, self.value, self.limit = quantity, value, limit
        what, to_do = self._OF[quantity]
        found, most = (
            f"{Quantity(number, 'm')}" if quantity == "length" else f"{number:g}{' s' * (quantity == 'duration')}"
            for number in (value, limit)
        )
        super().__init__(f"the plan's {what} would be {found}; this planner takes at most {most}, {to_do}")


class FarWaypointError(PlanningError):
    """A tool path leads to a place so far beyond the arm that it must be a mistake.

    Attributes:
        distance, reach: From the arm's first turning joint, and how far the arm reaches from there [m].
    """

    def __init__(self, waypoint: int, what: str, distance: float, reach: float):
        self.waypoint, self.distance, self.reach = waypoint, distance, reach
        away = f"{distance * 1e3:.0f}" if distance < 1e6 else f"{distance * 1e3:.6g}"
        super().__init__(
            f"waypoint {waypoint}: {what} is {away} mm from the arm, which reaches {reach * 1e3:.0f} mm; expected a place "
            "near the arm, in the frame of the request: are unit and frame right?"
        )


class NoSceneError(PlanningError):
    """It is not known what surrounds the arm, so nothing can be planned."""

    def __init__(self, source: str):
        super().__init__(
            Sentence("no scene was received on {source}; the scene node is not running, start it", source=source)
            if source
            else "there is no scene; give the pipeline one with set_scene, an empty one where nothing stands near the arm"
        )


class SceneChangedError(PlanningError):
    """The scene is another one than the one that was planned in."""

    def __init__(self, planned: str, present: str):
        before, now = planned[:8], present[:8]
        super().__init__(
            Sentence("the scene changed while planning, from {before} to {now}; ask again", before=before, now=now)
        )


class NeighbourUnknownError(PlanningError):
    """Where the other arm is, or goes, is not published; it is never taken to be absent."""

    def __init__(self, neighbour: str, problem: str):
        super().__init__(
            Sentence(
                "where {neighbour} is, or goes, is not known: {problem}; start it, or this robot without a neighbour",
                neighbour=neighbour,
                problem=problem,
            )
        )


class LimitError(PlanningError):
    """A motion breaks a limit of the robot.

    Attributes:
        where, joint, quantity: Such as ``at 1.204 s``; which joint; ``position``, ``velocity``, ``acceleration`` or ``jerk``.
        value, limit: [rad], [rad/s], ... ([m], ... for a prismatic joint); for a position `limit` is the end of the range that is
            passed.
    """

    def __init__(self, where: str, joint: str, quantity: str, value: float, limit: float, linear: bool = False):
        self.where, self.joint, self.quantity = where, joint, quantity
        self.value, self.limit = value, limit
        unit = ("m" if linear else "rad") + {"velocity": "/s", "acceleration": "/s^2", "jerk": "/s^3"}.get(quantity, "")
        super().__init__(
            Sentence(
                "{where}: {joint} has a {quantity} of {value}; its limit is {limit}; plan again",
                where=where,
                joint=joint,
                quantity=quantity,
                value=Quantity(value, unit),
                limit=Quantity(limit, unit),
            )
        )


class CartesianPathError(PlanningError):
    """The tool cannot follow its path to the end.

    Attributes:
        reason: ``joint limit``, ``singularity``, ``flip``, ``unreachable``, ``not found``, ``collision`` or ``deviation``.
        fraction, distance: How far it can be followed: fraction of the path's length, and metres (see `tool_path.TURN_LENGTH` for
            turns).
        waypoint: Number of the waypoint that the tool was going to, from 0.
        cause: The error behind it, with its own data: which joint, which pair, by how much.
    """

    def __init__(
        self, reason: str, fraction: float, distance: float, waypoint: int, what: str, cause: Exception | None = None
    ):
        self.reason, self.cause = reason, cause
        self.fraction, self.distance, self.waypoint = fraction, distance, waypoint
        super().__init__(
            Sentence(
                "the path ends {distance:.1} along, on the way to waypoint {waypoint} (fraction {fraction:.4f}): {what}",
                distance=Quantity(distance, "m"),
                waypoint=waypoint,
                fraction=fraction,
                what=what,
            )
        )


class SegmentError(PlanningError):
    """A segment of a work plan cannot be used, and so neither can the plan."""

    def __init__(self, number: int, name: str, cause: ConstructionTwinError):
        self.number, self.name, self.cause = number, name, cause
        super().__init__(
            Sentence("segment {number} ({name}): {cause}", number=number, name=repr(name[:80]), cause=str(cause))
        )


class FrameError(PlanningError):
    """A frame is not known."""

    #: So many frames are listed; tf may know hundreds.
    LISTED = 40

    def __init__(self, frame: str, base: str, cause: str, known: Sequence[str]):
        listed = ", ".join(known[: self.LISTED])
        if len(known) > self.LISTED:
            listed += f" and {len(known) - self.LISTED} more"
        super().__init__(f"no transform from frame {frame!r} to {base!r}: {cause}; known are {listed}")


class EngagedError(PlanningError):
    """The arm was left inside an engaged segment of a work plan: only the way back along the executed path can be planned."""

    def __init__(self, task: str, segment: str, reason: str):
        super().__init__(
            Sentence(
                "the arm was left in {segment} of task {task}{why}: only the way back along its path can be planned "
                "(plan_way_back, twin back), until its end, or until release_engagement says that it is free",
                segment=repr(segment),
                task=task,
                why=f" ({reason})" if reason else "",
            )
        )


class WaypointsError(PlanningError):
    """Waypoints from elsewhere cannot be used.

    Attributes:
        row, joint: Line of the file, or number of the point in a message (from 0); None and "" when no single one is at fault.
        value, limit: What was found, and the limit it breaks [SI]; None where there is none.
    """

    def __init__(
        self, message: str, row: int | None = None, joint: str = "", value: object = None, limit: float | None = None
    ):
        self.row, self.joint, self.value, self.limit = row, joint, value, limit
        super().__init__(message)


class WaypointTimesError(WaypointsError):
    """The times of waypoints ask for more than the arm may do; through the same points it could move at another pace."""


class TrajectoryError(PlanningError):
    """A list of waypoints is not a trajectory that may be executed."""
