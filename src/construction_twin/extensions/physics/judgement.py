"""When a rehearsal has failed: what was found, against what the arm may carry and give, and how far things may move. SI."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence, Set
from dataclasses import replace

import numpy as np

from construction_twin.core.sentences import Quantity, Sentence
from construction_twin.core.units import axis_name
from construction_twin.extensions.physics.drive import PayloadRating
from construction_twin.extensions.physics.mass import MassProperties
from construction_twin.review.rehearsal_report import PayloadLoad, RehearsalReport
from construction_twin.scene.collision_bodies import RobotBodies

#: An object stays where it is when it moves and turns by no more than this [m], [rad].
STAYS, STAYS_TURNED = 0.005, math.radians(1.0)
#: For so long what was let go is watched [s].
SETTLING = 2.0
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
    """Return the largest of each number of what the flange carries, one scene after the other, beside the arm's rating.

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
