"""A home pose for a new arm: free of contact, inside the ranges, not singular, in round numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from construction_twin.core.errors import ConfigurationError
from construction_twin.kinematics.chain import Chain
from construction_twin.scene.collision_world import CollisionWorld

#: Poses that are looked at, and how many of the best free ones are measured.
_CANDIDATES, _MEASURED = 4000, 60
#: Revolute joints stand at multiples of this [rad], at most three from zero.
_STEP = math.pi / 4
#: Distance from both ends of a range, as a fraction of the range.
_FROM_ENDS = 0.08
#: Enough clearance, as a fraction of the arm's reach.
_ENOUGH = 0.04


@dataclass(frozen=True)
class Home:
    """A home pose [rad] or [m], its clearance [m], and the closest pair; empty when no pair is checked."""

    q: tuple[float, ...]
    clearance: float
    between: tuple[str, ...]


def find_home(world: CollisionWorld, rng: np.random.Generator) -> Home:
    """Find a home pose: the best of many that has enough clearance.

    Preferred are poses far from singularities and ends of ranges, the tool in front of the base and looking down, most joints at
    zero.
    """
    robot = world.robot
    chain = Chain(robot)
    choices = [_home_candidates(*joint) for joint in zip(robot.lower, robot.upper, robot.linear)]
    poses = np.unique([[rng.choice(values) for values in choices] for _ in range(_CANDIDATES)], axis=0)
    order = np.argsort([-_score(chain, pose) for pose in poses], kind="stable")
    free: list[Home] = []
    in_contact: dict[tuple[str, str], int] = {}
    for q in poses[order]:
        contact = world.contact(q)
        if contact is not None:
            in_contact[contact.between] = in_contact.get(contact.between, 0) + 1
            continue
        found = world.clearance(q)
        free.append(Home(tuple(map(float, q)), float(found.distance), found.between))
        if len(free) == _MEASURED:
            break
    if not free:
        first, second = max(in_contact, key=lambda pair: in_contact[pair])
        raise ConfigurationError(
            "home pose", f"{len(poses)} poses, all in contact, most often {first} with {second}",
            "a pose that is free of contact: look at the collision shapes of these two",
        )  # fmt: skip
    # some links are close to each other whatever the joints do: more than the best of these cannot be asked for
    enough = min(_ENOUGH * chain.reach, 0.8 * max(home.clearance for home in free))
    return next(home for home in free if home.clearance >= enough)


def _home_candidates(lower: float, upper: float, linear: bool) -> list[float]:
    """Return the values at which a joint may stand at home."""
    low, high = lower + _FROM_ENDS * (upper - lower), upper - _FROM_ENDS * (upper - lower)
    middle = (lower + upper) / 2
    if linear:
        # whole millimetres
        return sorted({round(value, 3) for value in (middle, 0.0) if low <= value <= high})
    # zero twice as often as any other value
    whole = [step * _STEP for step in (-3, -2, -1, 0, 0, 1, 2, 3)]
    values = [value for value in whole if low <= value <= high]
    return values or [math.radians(round(math.degrees(middle)))]


def _score(chain: Chain, q: np.ndarray) -> float:
    """Return the score of a home pose, contacts ignored: larger is better."""
    robot = chain.robot
    jacobian = chain.jacobian(q)
    jacobian[:3] /= max(chain.arm_length, 1e-6)
    # an arm with fewer than six joints has no more directions than joints
    smallest = float(np.linalg.svd(jacobian, compute_uv=False)[min(jacobian.shape) - 1])
    tip = chain.forward(q)
    forward, _, height = tip.position / max(chain.reach, 1e-6)
    raised = float(chain.skeleton(q)[:, 2].mean()) / max(chain.reach, 1e-6)
    lower, upper = np.array(robot.lower), np.array(robot.upper)
    ends = float(np.minimum(q - lower, upper - q).min() / (upper - lower).max())
    turned = np.where(robot.linear, 0.0, np.abs(q))
    return (
        3.0 * smallest
        # the tip in front of the base, above it, and the tool down: where a person expects it
        + 0.3 * min(forward, 0.4)
        + min(0.0, height - 0.15)
        # the arm off the floor
        + raised
        - 0.3 * float(tip.rotation[2, 2])
        + 0.5 * min(0.25, ends)
        # round numbers, and few of them
        - 0.02 * float(turned.sum())
        - 0.03 * int((turned > 1e-9).sum())
    )
