"""How far a motion goes on after it was told to stop: stated in advance, and as it happened.

Pure. Angles in rad, m for prismatic joints; deg and mm in the sentences for people.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from construction_twin.core.sentences import Quantity, Sentence
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
        most = []
        for linear, unit in ((False, "rad"), (True, "m")):
            joints = [index for index, one in enumerate(robot.linear) if one is linear]
            if joints:
                joint = max(joints, key=lambda index: self.joints[index])
                most.append((Quantity(self.joints[joint], unit), robot.joint_names[joint]))
        if len(most) == 1:
            return Sentence("executor.path", time=self.time, distance=most[0][0], joint=most[0][1])
        (turn, revolute), (slide, carriage) = most
        return Sentence(
            "executor.path_of_two", time=self.time, turn=turn, joint=revolute, slide=slide, carriage=carriage
        )


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
        path = self.setpoints.text(robot)
        if self.lag <= 0.0:
            return Sentence("executor.stop.forecast", path=path)
        return Sentence("executor.stop.forecast_of_arm", path=path, lag=self.lag, arm=self.arm.text(robot))
