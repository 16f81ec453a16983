"""How well an arm can move from where it is: manipulability, distance to its limits, distance to singularities."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from construction_twin.kinematics.chain import Chain
from construction_twin.robot import RobotModel


def manipulability(chain: Chain, q: Sequence[float]) -> float:
    """Return Yoshikawa's manipulability: the volume of the ellipsoid of tip velocities, up to a constant.

    Parameters
    ----------
    chain : Chain
    q : sequence of float, length n
        [rad], or [m] for a linear joint.

    Returns
    -------
    manipulability : float
        Product of the six singular values of the scaled Jacobian (see `scaled_jacobian`); 0 at a singularity. Only
        comparable within one arm.
    """
    return float(np.prod(_singular_values(chain, q)))


def singularity_distance(chain: Chain, q: Sequence[float]) -> float:
    """Return the smallest singular value of the scaled Jacobian.

    Parameters
    ----------
    chain : Chain
    q : sequence of float, length n
        [rad], or [m] for a linear joint.

    Returns
    -------
    distance : float
        How fast the tip moves in its worst direction per unit of joint speed; 0 at a singularity. Without a unit, see
        `scaled_jacobian`.
    """
    return float(_singular_values(chain, q)[-1])


def limit_distance(robot: RobotModel, q: Sequence[float]) -> tuple[float, str]:
    """Return how far the joint nearest to an end of its range is from it.

    Parameters
    ----------
    robot : RobotModel
    q : sequence of float, length n
        [rad], or [m] for a linear joint.

    Returns
    -------
    distance : float
        As a share of half the joint's range: 1 in the middle, 0 at an end, negative outside. So joints that turn and
        linear ones compare.
    joint : str
        Its name.

    Raises
    ------
    ValueError
        If `q` has another length.
    """
    if len(q) != len(robot.joint_names):
        raise ValueError(f"{len(q)} joint values for {len(robot.joint_names)} joints of {robot.name}")
    lower, upper = np.array(robot.lower), np.array(robot.upper)
    shares = np.minimum(q - lower, upper - q) / (0.5 * (upper - lower))
    joint = int(shares.argmin())
    return float(shares[joint]), robot.joint_names[joint]


def scaled_jacobian(chain: Chain, q: Sequence[float]) -> np.ndarray:
    """Return the tip's Jacobian with lengths in units of the arm's size, so that translation and rotation compare.

    The characteristic length is half of `Chain.reach` (without the strokes of linear joints): about what one link of the
    arm is long. Linear joints count per characteristic length, too.

    Parameters
    ----------
    chain : Chain
    q : sequence of float, length n
        [rad], or [m] for a linear joint.

    Returns
    -------
    jacobian : array, shape (6, n)
        Without a unit.

    Raises
    ------
    ValueError
        If `q` has another length.
    """
    length = 0.5 * chain.arm_length
    jacobian = chain.jacobian(q)
    jacobian[:3] /= length
    jacobian[:, np.array(chain.robot.linear)] *= length
    return jacobian


def _singular_values(chain: Chain, q: Sequence[float]) -> np.ndarray:
    return np.linalg.svd(scaled_jacobian(chain, q), compute_uv=False)
