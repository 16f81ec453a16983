"""A plan's loads against the arm's ratings, and the reasons for a failed rehearsal. SI."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence, Set
from dataclasses import replace

import mujoco
import numpy as np

from construction_twin.core.sentences import Quantity, Sentence
from construction_twin.core.units import CYCLE, axis_name
from construction_twin.extensions.physics.arm import GravityTorque, Servo, SimulatedArm, is_broken
from construction_twin.extensions.physics.drive import ArmDrives, PayloadRating
from construction_twin.extensions.physics.mass import MassProperties
from construction_twin.extensions.physics.model import PhysicsModel
from construction_twin.review.rehearsal_report import AxisLoad, Braking, PayloadLoad, RehearsalReport
from construction_twin.robot.description import RobotModel
from construction_twin.scene.collision_bodies import RobotBodies

#: An object stays where it is when it moves and turns by no more than this [m], [rad].
STAYS, STAYS_TURNED = 0.005, math.radians(1.0)
#: For so long what was let go is watched [s].
SETTLING = 2.0
#: Longest time that braking may take [s].
_LONGEST_BRAKING = 10.0
#: The arm is off its setpoint by more than this, beyond its lag, when something holds it [rad], [m].
LARGEST_TRACKING = math.radians(0.5)


def failure_reasons(report: RehearsalReport, linear: Set[str]) -> Iterator[Sentence]:
    """Yield why a rehearsal has failed; `linear`: names of prismatic joints."""
    load, centre = report.payload, Sentence("centre of mass from the flange")
    for what, found, rated, unit in (
        (Sentence("mass"), load.mass, load.rated_mass, "kg"),
        (Sentence("moment of inertia at the flange"), load.inertia, load.rated_inertia, "kg m^2"),
        (centre, abs(load.across) * 1e3, load.rated_across * 1e3, "mm"),
        (centre, abs(load.along) * 1e3, load.rated_along * 1e3, "mm"),
    ):
        if rated and found > rated:
            yield Sentence(
                "the load's {what} is {found:.1q}; the arm is rated for {rated:.1q}",
                what=what,
                found=Quantity(found, unit),
                rated=Quantity(rated, unit),
            )
    for axis in report.axes:
        if axis.limit and axis.usage > 1.0:
            unit = "N" if axis.joint in linear else "Nm"
            yield Sentence(
                "{joint} needs {peak:.0q} after {time:.2f} s; it has {limit:.0q} ({percent:.0f} %)",
                joint=axis_name(axis.joint),
                peak=Quantity(axis.peak, unit),
                limit=Quantity(axis.limit, unit),
                percent=axis.usage * 100.0,
                time=axis.time,
            )
    if report.braking.usage > 1.0 and not report.contacts:
        yield Sentence(
            "braking after {time:.2f} s takes {percent:.0f} % of an axis' torque: the arm would not stop within its limits",
            time=report.braking.time,
            percent=report.braking.usage * 100.0,
        )
    if report.grip.usage > 1.0:
        grip = report.grip
        yield Sentence(
            "at {time:.2f} s {object} may slip or come off: one of its {cups} cups would need {percent:.0f} % of what it holds; "
            "plan a slower motion, or another grip",
            object=grip.name,
            time=grip.time,
            percent=grip.usage * 100.0,
            cups=grip.cups,
        )
    for contact in report.contacts:
        yield Sentence(
            "{first} touches {second} after {time:.2f} s, with up to {force:.0f} N",
            first=contact.first,
            second=contact.second,
            time=contact.time,
            force=contact.force,
        )
    for one in report.objects:
        moves, let_go = one.moved > STAYS or one.turned > STAYS_TURNED, math.isfinite(one.released)
        distance, angle = one.moved * 1e3, Quantity(one.turned, "rad")
        if let_go and one.fell > STAYS:
            yield Sentence(
                "{object}, let go after {time:.2f} s, falls {distance:.0f} mm",
                object=one.name,
                time=one.released,
                distance=one.fell * 1e3,
            )
        elif let_go and moves:
            yield Sentence(
                "{object}, let go after {time:.2f} s, does not stay: it moves {distance:.0f} mm and turns {angle:.1}",
                object=one.name,
                time=one.released,
                distance=distance,
                angle=angle,
            )
        elif moves:
            yield Sentence(
                "{object}, which the plan does not touch, moves {distance:.0f} mm and turns {angle:.1}",
                object=one.name,
                distance=distance,
                angle=angle,
            )
    if report.tracking > LARGEST_TRACKING and not report.contacts:
        error = Quantity(report.tracking, "m" if report.tracking_joint in linear else "rad")
        yield Sentence("{joint} is held {error:.2} off its path", joint=axis_name(report.tracking_joint), error=error)


def worst_payload(payloads: Sequence[MassProperties], bodies: RobotBodies, rating: PayloadRating | None) -> PayloadLoad:
    """Return the largest of each number of the flange's load, one scene after the other, beside the arm's rating.

    `payloads`: In the frame of the last joint.
    """
    rated = PayloadLoad()
    if rating is not None:
        rated = PayloadLoad(
            rated_mass=rating.mass_kg,
            rated_inertia=rating.inertia_kg_m2 or 0.0,
            rated_across=rating.across_m or 0.0,
            rated_along=rating.along_m or 0.0,
        )
    if not payloads:
        return rated
    frame = bodies.model.frames[bodies.model.getFrameId(bodies.robot.tip_link)]
    numbers = []
    for payload in payloads:
        at_flange = payload.at(frame.placement.inverse())
        centre = at_flange.centre
        x, y, z = centre.tolist()
        about = at_flange.inertia + at_flange.mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
        numbers.append((at_flange.mass, math.hypot(x, y), z, float(np.linalg.eigvalsh(about).max())))
    worst = np.argmax(np.abs(numbers), axis=0)
    mass, across, along, inertia = (numbers[number][kind] for kind, number in enumerate(worst))
    estimated = any(payloads[number].estimated for number in worst)
    return replace(rated, mass=mass, estimated=estimated, across=across, along=along, inertia=inertia)


class Track:
    """The arm's way through a plan, cycle by cycle. SI.

    Attributes:
        torques: The largest that each axis needed in a cycle.
        speeds, poses: At its end.
        gravity: Torques that would hold the arm still there.
        usages: The largest fraction of an axis' torque.
        off: Furthest that each axis was off its setpoint, without the servo's lag, until now.
    """

    def __init__(self, drives: ArmDrives):
        self._drives = drives
        self.limit = np.array([torque or math.inf for torque in drives.torque])
        self.torques: list[np.ndarray] = []
        self.speeds: list[np.ndarray] = []
        self.poses: list[np.ndarray] = []
        self.gravity: list[np.ndarray] = []
        self.usages: list[float] = []
        self.kinetic: list[float] = []
        self.off = np.zeros(len(self.limit))

    def record_cycle(self, arm: SimulatedArm, peak: np.ndarray, gravity: GravityTorque) -> None:
        """Record a cycle, with the largest torque of each axis in it."""
        q = arm.q
        self.torques.append(peak)
        self.speeds.append(arm.data.qvel[arm.physics.joints].copy())
        self.poses.append(q)
        self.gravity.append(gravity.at(arm.data))
        self.usages.append(float((np.abs(peak) / self.limit).max()))
        self.kinetic.append(gravity.kinetic(arm.data))
        np.maximum(self.off, np.abs(q - arm.answer), out=self.off)

    def axes(self, names: Sequence[str], times: np.ndarray) -> tuple[AxisLoad, ...]:
        """Return the load of each axis; `times`: of the cycles [s]."""
        torques, gravity = np.array(self.torques), np.array(self.gravity)
        found = []
        for joint, name in enumerate(names):
            at = int(np.argmax(np.abs(torques[:, joint])))
            peak = float(abs(torques[at, joint]))
            found.append(
                AxisLoad(
                    name,
                    peak,
                    float(times[at]),
                    float(np.sqrt(np.mean(torques[:, joint] ** 2))),
                    float(abs(gravity[at, joint]) / peak) if peak else 0.0,
                    self._drives.torque[joint] or 0.0,
                    "torque" in self._drives.estimates,
                )
            )
        return tuple(found)

    def energy(self) -> float:
        """Return the energy that the drives put in [J]."""
        return float(np.sum(np.abs(np.array(self.torques) * np.array(self.speeds))) * CYCLE)


def braking(track: Track, robot: RobotModel, model_at: Callable[[float], PhysicsModel]) -> Braking:
    """Stop the arm at the moment of its largest kinetic energy, all axes in the time that the slowest needs.

    `model_at`: Returns the arm at a time of the plan [s], with nothing loose.
    """
    number = int(np.argmax(track.kinetic))
    speed, begin = track.speeds[number], track.poses[number]
    seconds = float(np.max(np.abs(speed) / np.array(robot.acceleration)))
    if seconds <= 0.0 or not math.isfinite(seconds):
        return Braking(time=number * CYCLE)
    # how far the arm goes on, whatever stands in the way
    physics = model_at(number * CYCLE)
    physics.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    arm = SimulatedArm(physics, begin, Servo(saturates=False))
    arm.set_speed(speed)
    flange, usage, step = _flange(arm), 0.0, physics.model.opt.timestep
    # from `speed` to rest at a steady rate
    passed = np.arange(1, round(min(seconds, _LONGEST_BRAKING) / step) + 1)[:, None] * step
    left = np.maximum(0.0, 1.0 - passed / seconds)
    answers = begin + speed * seconds * (1.0 - left**2) / 2.0
    speeds = np.diff(np.vstack((begin, answers)), axis=0) / step
    accelerations = np.diff(np.vstack((speed, speeds)), axis=0) / step
    for _step in arm.follow(answers, speeds, accelerations):
        usage = float(np.maximum(usage, (np.abs(arm.needed) / track.limit).max()))
    if is_broken(arm.data):
        usage = math.nan
    way = np.abs(arm.q - begin)
    joint = int(np.argmax(way))
    distance = float(np.linalg.norm(_flange(arm) - flange))
    return Braking(number * CYCLE, seconds, distance, robot.joint_names[joint], float(way[joint]), usage)


def _flange(arm: SimulatedArm) -> np.ndarray:
    """Return where the last joint's frame is, shape (3,) [m]."""
    joint = arm.physics.robot.joint_names[-1]
    return arm.data.body(f"joint\n{joint}").xpos.copy()
