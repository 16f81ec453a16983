"""Masses of links, tools and workpieces; unknown ones are estimated from a volume and a density. SI."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio

from construction_twin.core.errors import ConfigurationError
from construction_twin.scene.collision_bodies import Body, RobotBodies

#: Length of a step [s]: a quarter of a cycle.
STEP = 0.001
#: Acceleration of gravity, along -z of the root [m/s^2] (DIN 1305).
GRAVITY = 9.80665
#: Friction of two bodies [1], where unknown: wood, brick and steel lie between 0.3 and 0.6.
FRICTION = 0.4
#: Taken for a shape of unknown material [kg/m^3]: between spruce and aluminium, as what a lab carries is.
UNKNOWN_DENSITY = 1000.0
#: A body of no volume, a plate of a surface mesh, has this mass [kg]: MuJoCo simulates nothing that weighs nothing.
LEAST_MASS = 1e-3
#: No payload of a number is heavier [kg] or farther from the tip link [m].
_LARGEST_PAYLOAD, _LARGEST_DISTANCE = 1e4, 10.0


@dataclass(frozen=True, eq=False)
class MassProperties:
    """Mass, centre and inertia of a rigid body.

    Attributes:
        centre: Shape (3,). Centre of mass in the body's frame [m].
        inertia: Shape (3, 3). About the centre of mass, axes of the body's frame [kg m^2].
        estimated: Calculated from a volume and an assumed density.
    """

    mass: float
    centre: np.ndarray
    inertia: np.ndarray
    estimated: bool = False

    def at(self, placement: pinocchio.SE3) -> MassProperties:
        """Return the same body seen from a frame in which it lies at `placement`."""
        rotation = placement.rotation
        return MassProperties(
            self.mass, placement.act(self.centre), rotation @ self.inertia @ rotation.T, self.estimated
        )

    def scaled_to(self, mass: float) -> MassProperties:
        """Return a body of the same shape with a known mass [kg]."""
        return MassProperties(mass, self.centre, self.inertia * (mass / self.mass), False)


def payload_of(numbers: Sequence[float], name: str) -> MassProperties | None:
    """Return the payload of a mass [kg], or of a mass and its centre [m], in the frame of the tip link; of no numbers None."""
    if not numbers:
        return None
    mass, *centre = numbers
    is_payload = len(numbers) in (1, 4) and LEAST_MASS <= mass <= _LARGEST_PAYLOAD
    if not is_payload or not math.hypot(*centre) <= _LARGEST_DISTANCE:
        expected = "a mass above 0 [kg], or a mass and its centre in the tip link: KG,X,Y,Z [kg], [m]"
        raise ConfigurationError(name, tuple(numbers), expected)
    # a cube of 20 cm, where unknown
    return MassProperties(mass, np.array(centre or (0.0, 0.0, 0.0)), np.eye(3) * mass * 0.04 / 6.0)


def combined(parts: Sequence[MassProperties]) -> MassProperties:
    """Return the properties of parts that are one rigid body, all in one frame."""
    mass = sum(part.mass for part in parts)
    centre = sum((part.mass * part.centre for part in parts), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for part in parts:
        away = part.centre - centre
        inertia += part.inertia + part.mass * (away @ away * np.eye(3) - np.outer(away, away))
    return MassProperties(mass, centre, inertia, any(part.estimated for part in parts))


def of_shape(geometry: coal.CollisionGeometry, density: float = UNKNOWN_DENSITY) -> MassProperties:
    """Return the properties of a solid of one density [kg/m^3] in its own frame; of an open surface `LEAST_MASS`, as a box."""
    volume = geometry.computeVolume()
    mass = abs(volume) * density
    if mass > LEAST_MASS:
        # below 0: the mesh's triangles are turned inside out
        inertia = np.array(geometry.computeMomentofInertiaRelatedToCOM(), dtype=float) * math.copysign(density, volume)
        if np.linalg.eigvalsh(inertia).min() > 0.0:
            return MassProperties(mass, np.array(geometry.computeCOM(), dtype=float).ravel(), inertia, True)
    geometry.computeLocalAABB()
    size = np.array(geometry.aabb_local.max_ - geometry.aabb_local.min_, dtype=float).ravel()
    size = np.maximum(size, 1e-3)
    mass = max(mass, LEAST_MASS)
    squares = size**2
    inertia = np.diag(mass / 12.0 * (squares.sum() - squares))
    return MassProperties(mass, np.array(geometry.aabb_center, dtype=float).ravel(), inertia, True)


def of_object(pieces: Sequence[Body]) -> MassProperties:
    """Return the properties of a scene object of one density, in its own frame; `pieces`: what `RobotBodies.place` gives."""
    shapes = pieces[0].shapes
    if shapes is not None and shapes.whole is not None:
        return of_shape(shapes.whole)
    parts = [of_shape(piece.geometry) for piece in pieces]
    return parts[0] if len(parts) == 1 else combined(parts)


def check_serial(bodies: RobotBodies) -> None:
    """Raise a ConfigurationError for an arm with a joint that follows another: one serial chain is simulated."""
    names = [name for index, name in enumerate(bodies.model.names) if index and name not in bodies.robot.joint_names]
    if names:
        raise ConfigurationError("URDF", ", ".join(names), "an arm of which no joint follows another")


def of_link(bodies: RobotBodies, index: int) -> tuple[MassProperties, list[str]]:
    """Return the mass properties of a joint's links, in its frame, and remarks.

    It is what the URDF says, or, where that says nothing, their shapes at `UNKNOWN_DENSITY`.
    """
    name, inertia = bodies.model.names[index], bodies.model.inertias[index]
    if inertia.mass <= 0.0:
        shapes = [of_shape(one.geometry).at(one.placement) for one in bodies.bodies if one.joint == index]
        found = combined(shapes) if shapes else MassProperties(LEAST_MASS, np.zeros(3), np.eye(3) * 1e-6, True)
        how = f"the URDF gives no mass for what {name} moves; estimated from its shapes: {found.mass:.1f} kg"
        return found, [how] if found.estimated else []
    matrix = np.array(inertia.inertia, dtype=float)
    low, middle, high = np.linalg.eigvalsh(matrix)
    # a point mass has none: a thousandth of a kilogram a metre away keeps the equations solvable and changes nothing
    if high <= 0.0:
        matrix, low, middle, high = matrix + np.eye(3) * 1e-6, 1e-6, 1e-6, 1e-6
    if low < 0.0 or high > (low + middle) * (1 + 1e-6):
        expected = (
            "principal moments of which none is negative and the largest is at most the sum of the others [kg m^2]"
        )
        raise ConfigurationError(f"URDF link {name} inertia", np.round([low, middle, high], 6).tolist(), expected)
    return MassProperties(inertia.mass, np.array(inertia.lever, dtype=float), matrix), []
