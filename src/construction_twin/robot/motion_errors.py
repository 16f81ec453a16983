"""Errors that several of robot, kinematics, scene and planning raise; those of one module stand there."""

from __future__ import annotations

from construction_twin.core.errors import ConstructionTwinError, found_and_expected
from construction_twin.core.sentences import Quantity, Sentence


class KinematicsError(ConstructionTwinError):
    """A pose or joint values out of what the arm can do."""


class JointRangeError(KinematicsError):
    """A joint position lies outside its range; `value`, `lower`, `upper` in rad, of a prismatic joint in m."""

    def __init__(self, joint: str, value: float, lower: float, upper: float, linear: bool = False):
        self.joint, self.value, self.lower, self.upper, self.linear = joint, value, lower, upper, linear
        found, low, high = (Quantity(number, "m" if linear else "rad") for number in (value, lower, upper))
        super().__init__(self._sentence(joint=joint, value=found, lower=low, upper=high))

    def _sentence(self, **values: str | Quantity) -> Sentence:
        return Sentence("{joint} is {value}, outside its range {lower} to {upper}", **values)


class SceneError(ConstructionTwinError):
    """The scene, or a change to it, does not make sense; the scene stays as it was."""

    def __init__(self, where: str, value: object, expected: str):
        self.where, self.value, self.expected = where, value, expected
        super().__init__(found_and_expected(where, value, expected))


class PlanningError(ConstructionTwinError):
    """A motion could not be planned or timed."""


class TrajectoryError(PlanningError):
    """A list of waypoints is not a trajectory that may be executed."""
