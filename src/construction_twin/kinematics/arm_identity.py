"""Whether a controller's arm is the model's: the pose that it reports of its tool, against forward kinematics of the same axes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial

from PyKDL import Frame, Joint, Rotation, Vector, diff

from construction_twin.core.sentences import Quantity, Sentence
from construction_twin.kinematics.chain import Chain
from construction_twin.robot.description import RobotModel
from construction_twin.robot.frames import pendant_text, rotation_to_abc

#: An axis that differs by this much makes another pose, which tells causes apart [rad], [m]; most that are kept.
_ANOTHER, _MOST = 0.1, 6
#: Lengths of the model below this are none [m].
_SHORTEST = 0.001
#: Most causes that are named, the likeliest first.
_MOST_NAMED = 3

_Joints = tuple[float, ...]


def frame_of(pose: Sequence[float]) -> Frame:
    """Return the frame of X, Y, Z [m] and KUKA's A, B, C [rad]."""
    return Frame(Rotation.EulerZYX(*pose[3:]), Vector(*pose[:3]))


class ArmIdentity:
    """Compares what a controller reports of its arm with a robot.

    Args:
        tool, base: As the controller is expected to have them, at the flange and in base_link.
        distance, angle: How far the tool may be off [m], [rad].
    """

    def __init__(self, robot: RobotModel, tool: Frame, base: Frame, distance: float, angle: float):
        self._robot, self._chain = robot, Chain(robot)
        self._tool, self._base = tool, base
        self._distance, self._angle = distance, angle
        # joint values, and the tool that was reported there; the newest last
        self._samples: list[tuple[_Joints, Frame]] = []

    def compare(self, axes: Sequence[float], pose: Sequence[float], explains: bool = True) -> tuple[float, float, str]:
        """Return how far a reported pose [m], [rad] is off [m], [rad], and why it is too far; "": it is not.

        Args:
            explains: False: no cause is looked for, which takes some ms.
        """
        q = self._robot.from_axes(axes)
        reported = frame_of(pose)
        distance, angle = _difference(self._predict(q), reported)
        if distance <= self._distance and angle <= self._angle:
            return distance, angle, ""
        problem = Sentence(
            "the controller's tool is {distance:.2} and {angle:.2} off the model's (allowed {most}, {most_angle})",
            distance=Quantity(distance, "m"),
            angle=Quantity(angle, "rad"),
            most=Quantity(self._distance, "m"),
            most_angle=Quantity(self._angle, "rad"),
        )
        if explains:
            problem = Sentence("{problem}: {cause}", problem=problem, cause=self._cause(q, reported))
        return distance, angle, problem

    def _cause(self, q: _Joints, reported: Frame) -> Sentence:
        others = [sample for sample in self._samples if max(abs(a - b) for a, b in zip(sample[0], q)) > _ANOTHER]
        self._samples = [*others, (q, reported)][-_MOST:]
        # what was seen before may be of a tool or a base that was corrected since
        causes = self._causes(self._samples) or self._causes(self._samples[-1:])
        if not causes:
            return Sentence("no single cause: compare $TOOL, $BASE and every axis with the pendant")
        cause = causes[0]
        for other in causes[1:_MOST_NAMED]:
            cause = Sentence("{cause}; or {other}", cause=cause, other=other)
        if len(causes) > 1 and len(self._samples) == 1:
            cause = Sentence("{why}; the same at another pose of the arm tells them apart", why=cause)
        return cause

    def _causes(self, samples: list[tuple[_Joints, Frame]]) -> list[Sentence]:
        """Return the causes that explain every sample with the fewest wrong numbers."""
        found = []
        for wrong, sentence, predict in self._candidates(*samples[-1]):
            errors = [_difference(predict(q), reported) for q, reported in samples]
            if all(distance <= self._distance and angle <= self._angle for distance, angle in errors):
                found.append((wrong, sentence))
        fewest = min((wrong for wrong, _ in found), default=0)
        return [sentence for wrong, sentence in found if wrong == fewest]

    def _candidates(self, q: _Joints, reported: Frame) -> Iterator[tuple[int, Sentence, Callable[[_Joints], Frame]]]:
        """Yield what one sample may come from: how many numbers are wrong, the sentence, and the tool at any joint values."""
        tool, base, nothing, flange = self._tool, self._base, Frame(), self._chain.frames(q)[-1]
        if tool != nothing:
            yield 0, Sentence("$TOOL is not set"), partial(self._predict, tool=nothing)
        if base != nothing:
            yield 0, Sentence("$BASE is not set"), partial(self._predict, base=nothing)
        wanted = base * reported * tool.Inverse()
        turn, directions = (wanted * flange.Inverse()).M.GetRot(), self._chain.jacobian(q)[3:].T.tolist()
        for i, axis in enumerate(self._robot.axes):
            sentence = Sentence("axis {axis} counts the other way (`sign` in the robot YAML)", axis=axis.name)
            yield 0, sentence, partial(self._with_axis, i, -1.0, 0.0)
            slip = sum(a * b for a, b in zip(turn, directions[i]))
            sentence = Sentence(
                "axis {axis} has another zero (`offset_deg` in the robot YAML: {angle:.2} more)",
                axis=axis.name,
                angle=Quantity(-axis.sign * slip, "rad"),
            )
            yield 1, sentence, partial(self._with_axis, i, 1.0, slip)
        other = flange.Inverse() * base * reported
        sentence = Sentence("$TOOL is {pose}", pose=pendant_text(other))
        yield self._wrong_numbers(other, tool), sentence, partial(self._predict, tool=other)
        other = flange * tool * reported.Inverse()
        sentence = Sentence("$BASE is {pose}, seen from $ROBROOT", pose=pendant_text(other))
        yield self._wrong_numbers(other, base), sentence, partial(self._predict, base=other)
        # a length of another model; one before the first axis or behind the last is as good as a base or a tool
        frames, kdl = self._chain.frames(q), self._chain.kdl
        segments = [kdl.getSegment(k) for k in range(kdl.getNrOfSegments())]
        moving = [k for k, segment in enumerate(segments) if segment.getJoint().getType() != Joint.Fixed]
        for k in range(moving[0] + 1, moving[-1] + 1):
            for unit in (Vector(1, 0, 0), Vector(0, 1, 0), Vector(0, 0, 1)):
                direction = frames[k].M * unit
                length, longer = (_dot(a.p - b.p, direction) for a, b in ((frames[k + 1], frames[k]), (wanted, flange)))
                if abs(length) < _SHORTEST:
                    continue
                sentence = Sentence(
                    "another model: the {length} to {link} are {other}",
                    length=Quantity(abs(length), "m"),
                    link=segments[k].getName(),
                    other=Quantity(abs(length + longer), "m"),
                )
                yield 1, sentence, partial(self._predict, at=k, shift=unit * longer)

    def _with_axis(self, index: int, factor: float, slip: float, q: _Joints) -> Frame:
        return self._predict((*q[:index], factor * q[index] + slip, *q[index + 1 :]))

    def _predict(
        self, q: _Joints, tool: Frame | None = None, base: Frame | None = None, at: int = 0, shift: Vector = Vector()
    ) -> Frame:
        """Return the tool that a controller would report, the arm from link `at` on shifted in that link."""
        frames = self._chain.frames(q)
        flange = Frame(frames[-1].M, frames[-1].p + frames[at].M * shift)
        return (self._base if base is None else base).Inverse() * flange * (self._tool if tool is None else tool)

    def _wrong_numbers(self, found: Frame, expected: Frame) -> int:
        """Return in how many of its six numbers a frame differs from the expected one."""
        angles = zip(rotation_to_abc(found), rotation_to_abc(expected))
        wrong = [abs(math.remainder(a - b, math.tau)) > self._angle for a, b in angles]
        return sum(wrong) + sum(abs(value) > self._distance for value in found.p - expected.p)


def _difference(frame: Frame, other: Frame) -> tuple[float, float]:
    twist = diff(frame, other)
    return twist.vel.Norm(), twist.rot.Norm()


def _dot(vector: Vector, other: Vector) -> float:
    return sum(a * b for a, b in zip(vector, other))
