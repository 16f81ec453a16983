"""How far a motion goes on after it was told to stop: stated in advance, and as it happened.

Pure. Angles in rad, m for prismatic joints; deg and mm in the sentences for people.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from construction_twin.core.units import CYCLE
from construction_twin.robot.description import RobotModel


@dataclass(frozen=True)
class StoppingPath:
    """How far the joints move until they rest.

    Attributes:
        joints: Length n. Distance of each joint, there and back both counted [rad], [m].
        time: [s]
    """

    joints: tuple[float, ...]
    time: float

    def text(self, robot: RobotModel) -> str:
        """Return time and distance of the joints that move most, one revolute and one prismatic, for people: deg and mm."""
        distances = []
        for linear, scale, unit in ((False, math.degrees(1.0), "deg"), (True, 1000.0, "mm")):
            joints = [index for index, one in enumerate(robot.linear) if one is linear]
            if joints:
                most = max(joints, key=lambda index: self.joints[index])
                distances.append(f"{self.joints[most] * scale:.3f} {unit} of {robot.joint_names[most]}")
        return f"{self.time:.3f} s and at most {', '.join(distances)}"


def distance_along(poses: Iterable[Sequence[float]]) -> StoppingPath:
    """Return the distance along setpoints that follow each other by one cycle.

    Args:
        poses: Each of length n. At least one; the first is the pose when the stop was asked for [rad].
    """
    poses = iter(poses)
    last = next(poses)
    joints, cycles = [0.0] * len(last), 0
    for pose in poses:
        joints = [moved + abs(b - a) for moved, a, b in zip(joints, last, pose)]
        last, cycles = pose, cycles + 1
    return StoppingPath(tuple(joints), cycles * CYCLE)


@dataclass(frozen=True)
class StoppingForecast:
    """Where a stop will end, stated before it has.

    Attributes:
        setpoints: From the last setpoint before the stop to rest.
        arm: What the arm does from the moment of the stop: the same, and the setpoints before it that it has not reached yet.
        lag: How long the arm was taken to trail the setpoints [s].
    """

    setpoints: StoppingPath
    arm: StoppingPath
    lag: float

    def text(self, robot: RobotModel) -> str:
        """Return one clause for the answer to `stop`."""
        sentence = f"setpoints come to rest after {self.setpoints.text(robot)}"
        if self.lag <= 0.0:
            return sentence
        return f"{sentence}; the arm, {self.lag:.3f} s behind, after {self.arm.text(robot)}"
