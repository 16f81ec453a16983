"""Exceptions of kinematics, scene and planning: a branch of the tree in `errors`, kept apart because the gateway needs none of it.

Messages say what, where, the value, what was expected and what to do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.units import for_people


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
        where, to_do = ("too close to the arm", "away from") if too_close else ("out of the arm's reach", "closer to")
        super().__init__(f"the target is {where} by {missing * 1e3:.6g} mm; move it {to_do} the base")


class JointRangeError(KinematicsError):
    """A joint position lies outside its range.

    Attributes:
        value, lower, upper: [rad] ([m] for a prismatic joint).
        linear: The joint is prismatic.
    """

    def __init__(self, joint: str, value: float, lower: float, upper: float, linear: bool = False):
        self.joint, self.value, self.lower, self.upper, self.linear = joint, value, lower, upper, linear
        super().__init__(f"{joint} is {self.outside}")

    @property
    def outside(self) -> str:
        """Value and range in words, in deg or mm."""
        value, lower, upper = (
            for_people(number, "m" if self.linear else "rad") for number in (self.value, self.lower, self.upper)
        )
        return f"{value}, outside its range {lower} to {upper}"


class PoseRangeError(JointRangeError):
    """The target could be reached, but only with a joint outside its range.

    Attributes:
        joint: The joint that prevents it, in the solution that is out of range by least.
        value, lower, upper: What it would have to be, and its range [rad] ([m] for a prismatic joint).
    """


class PositionRangeError(PoseRangeError):
    """The wrist cannot get where the target needs it within the joint ranges."""

    def __init__(self, joint: str, value: float, lower: float, upper: float, linear: bool = False):
        super().__init__(joint, value, lower, upper, linear)
        self.args = (f"the target's position needs {joint} at {self.outside}; move the target",)


class OrientationError(PoseRangeError):
    """The target's position can be reached, but not with its orientation within the joint ranges."""

    def __init__(self, joint: str, value: float, lower: float, upper: float, linear: bool = False):
        super().__init__(joint, value, lower, upper, linear)
        self.args = (f"the target's orientation needs {joint} at {self.outside}; turn the target",)


class BranchError(KinematicsError):
    """A configuration of the arm (shoulder, elbow, wrist) is unknown, or does not exist for this arm or target.

    Attributes:
        asked: The configuration asked for.
        available: What could have been asked for; empty if the arm has no named configurations.
    """

    def __init__(self, asked: str, available: tuple[str, ...], reason: str):
        self.asked = asked
        self.available = available
        choice = f"choose one of: {', '.join(available)}" if available else "leave the choice open"
        super().__init__(f"configuration {asked!r} {reason}; {choice}")


class UnreachableOrientationError(KinematicsError):
    """The target's position can be reached, but not with its orientation, whatever the joint ranges."""

    def __init__(self) -> None:
        super().__init__(
            "the target cannot be reached with its orientation, whatever the joint ranges; its position can, turn the target"
        )


class NotFoundError(KinematicsError):
    """No joint solution was found in the time given, which does not prove that there is none.

    Attributes:
        tried: Number of starting points tried.
        budget_s: The time given [s].
        residual_m, residual_rad: Position and orientation error of the best attempt within the ranges; inf without any.
        hint: What the search saw besides: part of a sentence, or "".
    """

    def __init__(self, tried: int, budget_s: float, residual_m: float, residual_rad: float, hint: str = ""):
        self.tried, self.budget_s, self.hint = tried, budget_s, hint
        self.residual_m, self.residual_rad = residual_m, residual_rad
        seen = (
            [f"the best attempt was {residual_m * 1e3:.3f} mm and {math.degrees(residual_rad):.4f} deg away"]
            if residual_m < 1e3
            else []
        )
        seen += [hint] if hint else []
        super().__init__(
            f"no joint solution was found in the time given ({budget_s:.3g} s, {tried} starting points); it may still be "
            f"reachable, because this was searched, not computed: {'; '.join([*seen, 'allow more time or turn the target'])}"
        )


class SceneError(ConstructionTwinError):
    """The scene, or a change to it, does not make sense; the scene stays as it was.

    Attributes:
        where: What is wrong: an object's property (``object 'wall' size``), a name, a file.
        value: What was found there.
        expected: What would have been accepted.
    """

    def __init__(self, where: str, value: object, expected: str):
        self.where, self.value, self.expected = where, value, expected
        super().__init__(f"{where}: found {'nothing' if value is None else repr(value)}, expected {expected}")


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
        super().__init__(f"{planner} found no path within {budget:.3g} s; allow more time or choose another goal")


class CollisionError(PlanningError):
    """Two bodies that must not touch do.

    Attributes:
        between: Length 2. Names of the two: a link or a carried object first, then a link or an object of the scene.
        where: ``the start``, ``the goal``, ``at 1.204 s``, ...
    """

    def __init__(self, between: tuple[str, str], where: str):
        self.between = tuple(between)
        self.where = where
        first, second = between
        super().__init__(
            f"{first} touches {second} ({where}), or comes closer than the padding; expected no contact, "
            "choose another pose or change the scene"
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
        quantity: ``duration`` [s], ``waypoints`` or ``length of the tool's path`` [m].
    """

    def __init__(self, quantity: str, value: float, limit: float, unit: str, to_do: str):
        self.quantity, self.value, self.limit = quantity, value, limit
        found, most = (for_people(number, "m") if unit == " m" else f"{number:.6g}{unit}" for number in (value, limit))
        super().__init__(f"the plan's {quantity} would be {found}; this planner takes at most {most}, {to_do}")


class FarWaypointError(PlanningError):
    """A tool path leads to a place so far beyond the arm that it must be a mistake.

    Attributes:
        waypoint: Its number, from 0.
        distance, reach: From the arm's first turning joint, and how far the arm reaches from there [m].
    """

    def __init__(self, waypoint: int, what: str, distance: float, reach: float):
        self.waypoint, self.distance, self.reach = waypoint, distance, reach
        away = f"{distance * 1e3:.0f}" if distance < 1e6 else f"{distance * 1e3:.6g}"
        super().__init__(
            f"waypoint {waypoint}: {what} is {away} mm from the arm, which reaches {reach * 1e3:.0f} mm; expected a "
            "place near the arm, in the frame of the request: are unit and frame right?"
        )


class NoSceneError(PlanningError):
    """It is not known what surrounds the arm, so nothing can be planned.

    Attributes:
        source: Where the scene should come from.
    """

    def __init__(self, source: str):
        self.source = source
        super().__init__(f"no scene was received on {source}; the scene node is not running, start it and ask again")


class SceneChangedError(PlanningError):
    """The scene is another one than the one that was planned in.

    Attributes:
        planned, present: Hashes of both scenes.
    """

    def __init__(self, planned: str, present: str):
        self.planned = planned
        self.present = present
        super().__init__(
            f"the scene changed while planning, from {planned[:8]} to {present[:8]}; the plan was dropped, ask again"
        )


class NeighbourUnknownError(PlanningError):
    """Where the other arm is, or goes, is not published; it is never taken to be absent.

    Attributes:
        neighbour: Name of the other robot.
    """

    def __init__(self, neighbour: str, problem: str):
        self.neighbour = neighbour
        super().__init__(
            f"where {neighbour} is, or goes, is not known: {problem}; start it, or start this robot without a neighbour"
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
        found, allowed = for_people(value, unit), for_people(limit, unit)
        super().__init__(f"{where}: {joint} has a {quantity} of {found}; its limit is {allowed}; plan again")


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
            f"the path ends {distance * 1e3:.1f} mm along, on the way to waypoint {waypoint} (fraction {fraction:.4f}): {what}"
        )


class SegmentError(PlanningError):
    """A segment of a work plan cannot be used, and so neither can the plan.

    Attributes:
        number: Of the segment, from 0.
        cause: What is wrong with it, with its own data.
    """

    def __init__(self, number: int, name: str, cause: ConstructionTwinError):
        self.number, self.name, self.cause = number, name, cause
        super().__init__(f"segment {number} ({name[:80]!r}): {cause}")


class FrameError(PlanningError):
    """A frame is not known."""

    #: So many frames are listed; tf may know hundreds.
    LISTED = 40

    def __init__(self, frame: str, base: str, cause: str, known: Sequence[str]):
        self.frame = frame
        more = f" and {len(known) - self.LISTED} more" if len(known) > self.LISTED else ""
        super().__init__(
            f"no transform from frame {frame!r} to {base!r}: {cause}; known are {', '.join(known[: self.LISTED])}{more}"
        )


class EngagedError(PlanningError):
    """The arm was left inside an engaged segment of a work plan: only the way back along the executed path can be planned.

    Attributes:
        task, segment: Which task, and in which of its segments the arm was left.
    """

    def __init__(self, task: str, segment: str, reason: str):
        self.task, self.segment = task, segment
        super().__init__(
            f"the arm was left in {segment!r} of task {task}{f' ({reason})' if reason else ''}: only the way back along the path "
            "that it executed can be planned, with plan_way_back (twin back), until it has come to its end, or a person says with "
            "release_engagement that the arm is free"
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
