"""When a rehearsal has failed: what was found, against what the arm may carry and give, and how far things may move. SI."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass, replace

import numpy as np

from construction_twin.core.sentences import Quantity, Sentence
from construction_twin.core.units import axis_name
from construction_twin.physics.drive import PayloadRating
from construction_twin.physics.mass import MassProperties
from construction_twin.physics.report import PayloadLoad, RehearsalReport
from construction_twin.scene.collision_bodies import RobotBodies

#: An object that was let go stays where it is when it moves and turns by no more than this [m], [rad].
STAYS, STAYS_TURNED = 0.005, math.radians(1.0)
#: For so long what was let go is watched [s].
SETTLING = 2.0
#: The arm is off its setpoint by more than this, beyond its lag, when something holds it [rad], [m].
LARGEST_TRACKING = math.radians(0.5)


@dataclass(frozen=True)
class Limits:
    """From where on a rehearsal has failed.

    Attributes:
        torque: Fraction of an axis' torque.
        stays, stays_turned: How far what is let go may move [m] and turn [rad].
        settling: For how long that is watched [s].
    """

    torque: float = 1.0
    stays: float = STAYS
    stays_turned: float = STAYS_TURNED
    settling: float = SETTLING


def reasons(report: RehearsalReport, limits: Limits, linear: Set[str]) -> Iterator[Sentence]:
    """Yield why a rehearsal has failed; `linear`: names of prismatic joints."""
    load = report.payload
    if load.rated_mass and load.mass > load.rated_mass:
        yield Sentence(
            "the flange carries {mass:.1f} kg; the arm is rated for {rated:.1f} kg",
            mass=load.mass,
            rated=load.rated_mass,
        )
    if load.rated_inertia and load.inertia > load.rated_inertia:
        yield Sentence(
            "the load has a moment of inertia of {inertia:.1f} kg m^2 at the flange; the arm is rated "
            "for {rated:.1f} kg m^2",
            inertia=load.inertia,
            rated=load.rated_inertia,
        )
    for place, rated in ((load.across, load.rated_across), (load.along, load.rated_along)):
        if rated and abs(place) > rated:
            yield Sentence(
                "the load's centre of mass is {distance:.1} from the flange; the arm is rated for {rated:.1}",
                distance=Quantity(place, "m"),
                rated=Quantity(rated, "m"),
            )
    for axis in report.axes:
        if axis.limit and axis.usage > limits.torque:
            unit = "N" if axis.joint in linear else "Nm"
            yield Sentence(
                "{joint} needs {peak:.0q} after {time:.2f} s; it has {limit:.0q} ({percent:.0f} %)",
                joint=axis_name(axis.joint),
                peak=Quantity(axis.peak, unit),
                limit=Quantity(axis.limit, unit),
                percent=axis.usage * 100.0,
                time=axis.time,
            )
    if report.braking.usage > limits.torque and not report.contacts:
        yield Sentence(
            "braking after {time:.2f} s takes {percent:.0f} % of an axis' torque: the arm would not stop "
            "within its limits",
            time=report.braking.time,
            percent=report.braking.usage * 100.0,
        )
    if report.grip.usage > 1.0:
        grip = report.grip
        yield Sentence(
            "at {time:.2f} s {object} may slip or come off: of its {cups} cups one would need "
            "{percent:.0f} % of what it holds; plan a slower motion, or another grip",
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
        if math.isfinite(one.released):
            if one.fell > limits.stays:
                yield Sentence(
                    "{object}, let go after {time:.2f} s, falls {distance:.0f} mm",
                    object=one.name,
                    time=one.released,
                    distance=one.fell * 1e3,
                )
            elif one.moved > limits.stays or one.turned > limits.stays_turned:
                yield Sentence(
                    "{object}, let go after {time:.2f} s, does not stay: it moves {distance:.0f} mm and turns "
                    "{angle:.1}",
                    object=one.name,
                    time=one.released,
                    distance=one.moved * 1e3,
                    angle=Quantity(one.turned, "rad"),
                )
        elif one.moved > limits.stays or one.turned > limits.stays_turned:
            yield Sentence(
                "{object}, which the plan does not touch, moves {distance:.0f} mm and turns {angle:.1}",
                object=one.name,
                distance=one.moved * 1e3,
                angle=Quantity(one.turned, "rad"),
            )
    if report.tracking > LARGEST_TRACKING and not report.contacts:
        error = Quantity(report.tracking, "m" if report.tracking_joint in linear else "rad")
        yield Sentence("{joint} is held {error:.2} off its path", joint=axis_name(report.tracking_joint), error=error)


def worst_payload(payloads: Sequence[MassProperties], bodies: RobotBodies, rating: PayloadRating | None) -> PayloadLoad:
    """Return the largest of each number of what the flange carries, one scene after the other, beside the arm's rating.

    Args:
        payloads: In the frame of the last joint.
    """
    rated = PayloadLoad()
    if rating is not None:
        across, along = rating.distance or (0.0, 0.0)
        rated = PayloadLoad(
            rated_mass=rating.mass, rated_inertia=rating.inertia or 0.0, rated_across=across, rated_along=along
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
