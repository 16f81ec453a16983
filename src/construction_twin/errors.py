"""The package's exceptions: one tree, each carrying the data a caller needs to act on it.

Messages say what happened, the value, what was expected and what to do. Library code raises; only ``ros/`` and the
command-line entry points catch, and turn an error into a service answer, a counter or one sentence for the operator.
Standard library only: the gateway on the cell PC imports it.
"""

from __future__ import annotations


class ConstructionTwinError(Exception):
    """Root of every error this package raises."""


class ConfigurationError(ConstructionTwinError):
    """A parameter, file or robot description does not make sense.

    Attributes
    ----------
    where : str
        Resolved parameter name or file path.
    value : object
        What was found there.
    expected : str
        What would have been accepted.
    """

    def __init__(self, where: str, value: object, expected: str):
        self.where = where
        self.value = value
        self.expected = expected
        super().__init__(f"{where}: found {value!r}, expected {expected}")


class EthernetXmlError(ConfigurationError):
    """An RSI Ethernet XML cannot be used.

    Attributes
    ----------
    element : str
        Path or TAG of the element that does not fit, e.g. ``CONFIG/PORT`` or ``RECEIVE AK.A1 HOLDON``.
    """

    def __init__(self, where: str, element: str, value: object, expected: str):
        self.element = element
        super().__init__(f"{where}: {element}", value, expected)


class KinematicsError(ConstructionTwinError):
    """A pose has no usable joint solution, or joints have no usable pose."""


class UnreachableError(KinematicsError):
    """The target is further from the shoulder than the arm is long.

    Attributes
    ----------
    distance : float
        Distance of the target from the first joint axis' base point [m].
    reach : float
        Upper bound of the arm's reach from there [m].
    """

    def __init__(self, distance: float, reach: float):
        self.distance = distance
        self.reach = reach
        super().__init__(
            f"target is {distance:.3f} m from the arm's base, {distance - reach:.3f} m beyond its reach of {reach:.3f} m; "
            "move the target closer"
        )


class JointRangeError(KinematicsError):
    """A joint position lies outside its range.

    Attributes
    ----------
    joint : str
    value, lower, upper : float
        [rad] ([m] for a linear joint).
    """

    def __init__(self, joint: str, value: float, lower: float, upper: float):
        self.joint = joint
        self.value = value
        self.lower = lower
        self.upper = upper
        super().__init__(f"{joint} is {value:.6f}, outside its range {lower:.6f} to {upper:.6f}")


class NoSolutionError(KinematicsError):
    """No joint solution within the ranges was found.

    Attributes
    ----------
    seeds : int
        Number of starting points tried.
    residual_m, residual_rad : float
        Position and orientation error of the best attempt.
    """

    def __init__(self, seeds: int, residual_m: float, residual_rad: float):
        self.seeds = seeds
        self.residual_m = residual_m
        self.residual_rad = residual_rad
        super().__init__(
            f"no joint solution within the ranges after {seeds} seeds; the best attempt was {residual_m * 1e3:.3f} mm and "
            f"{residual_rad:.6f} rad away; try another orientation or a longer time budget"
        )


class PlanningError(ConstructionTwinError):
    """A motion could not be planned or timed."""


class NoPathError(PlanningError):
    """The planner found no path in its time budget.

    Attributes
    ----------
    planner : str
    budget : float
        [s]
    """

    def __init__(self, planner: str, budget: float):
        self.planner = planner
        self.budget = budget
        super().__init__(f"{planner} found no path within {budget:g} s; allow more time or choose another goal")


class DurationError(PlanningError):
    """The requested duration is shorter than the limits allow.

    Attributes
    ----------
    requested, minimum : float
        [s]
    """

    def __init__(self, requested: float, minimum: float):
        self.requested = requested
        self.minimum = minimum
        super().__init__(
            f"a duration of {requested:.3f} s breaks the joint limits; the shortest possible is {minimum:.3f} s"
        )


class TrajectoryError(PlanningError):
    """A list of waypoints is not a trajectory that may be executed."""


class ReviewError(ConstructionTwinError):
    """A verdict cannot be applied: wrong plan, wrong hash, no reviewer, or not the moment."""


class MotionRefused(ConstructionTwinError):
    """A setpoint fails the motion check and must not be executed.

    Attributes
    ----------
    reason : str
        Counter name: ``range``, ``velocity``, ``acceleration``, ``braking_room``, ``start``, ``order``, ``lead``, ``values``.
    joint : str
        Joint that failed, or "" when the setpoint as a whole did.
    value, limit : float
        In SI units of the check; nan when there is none.
    """

    def __init__(self, reason: str, joint: str, value: float, limit: float, unit: str = "rad"):
        self.reason = reason
        self.joint = joint
        self.value = value
        self.limit = limit
        subject = f"{joint}: " if joint else ""
        super().__init__(f"{subject}{reason} check failed: {value:.6g} {unit} against {limit:.6g} {unit}")


class ProtocolError(ConstructionTwinError):
    """A message from a network does not follow its protocol."""


class PayloadError(ProtocolError):
    """An MQTT payload or its properties are not what the interface says.

    Attributes
    ----------
    reason : str
        Counter name, e.g. ``length``, ``format``, ``ascii``, ``decimals``, ``properties``.
    """

    def __init__(self, reason: str, message: str):
        self.reason = reason
        super().__init__(message)


class TelegramError(ProtocolError):
    """An RSI telegram is not what the protocol says.

    Attributes
    ----------
    reason : str
        Counter name, e.g. ``size``, ``xml``, ``element``, ``number``.
    """

    def __init__(self, reason: str, message: str):
        self.reason = reason
        super().__init__(message)


class TransportError(ConstructionTwinError):
    """A socket or a connection cannot be used."""


class SiteError(ConstructionTwinError):
    """The certificates and accounts of a broker's site could not be made."""


class EvaluationError(ConstructionTwinError):
    """A recording does not hold what an evaluation needs."""


class ExperimentError(ConstructionTwinError):
    """The experiment cannot go on: something is not ready in time, or the task was not finished."""
