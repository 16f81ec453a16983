"""Inverse kinematics of any arm behind one interface: in closed form where the arm allows it, by search where not.

Users of solutions import from here; the classes behind are chosen by the arm's geometry. Two of them solve one joint more than a
closed form has. `redundant` takes any arm of seven joints, and could take an arm of the OPW kind on a linear axis, too. `rail`
knows how fast the joints of such an arm move along the axis, and looks between two samples wherever something nearer may be: it
takes half the time, and `redundant` gives a solution that is farther in one pose of eight (docs/measurements.md).
"""

from __future__ import annotations

import numpy as np

from construction_twin.core.clock import MONOTONIC, Clock
from construction_twin.kinematics.axes import joint_axes
from construction_twin.kinematics.chain import Chain
from construction_twin.kinematics.closed_form import ClosedFormInverse
from construction_twin.kinematics.decomposition import ClosedForm, NoClosedForm, find_closed_form
from construction_twin.kinematics.numeric import NumericInverse
from construction_twin.kinematics.opw import NotOpw, OpwModel, find_opw
from construction_twin.kinematics.rail import RailInverse, find_rail
from construction_twin.kinematics.redundant import RedundantInverse, find_redundant
from construction_twin.kinematics.solution import Configuration, IkSettings, IkSolution, InverseKinematics
from construction_twin.kinematics.subproblems import SubproblemInverse

__all__ = ["Configuration", "IkSettings", "IkSolution", "InverseKinematics", "inverse_kinematics"]


def inverse_kinematics(
    chain: Chain,
    settings: IkSettings | None = None,
    rng: np.random.Generator | None = None,
    clock: Clock = MONOTONIC,
) -> InverseKinematics:
    """Return the inverse kinematics that fits an arm.

    Args:
        settings: Default: those of an `IkSettings` without arguments.
        rng: Source of the search's starting points. Default: one with a fixed seed, so that a program finds the same each time.
        clock: Returns the present time [s]: for the search's budget.

    Returns:
        The first that fits: of the OPW kind (`opw`), another closed form (`decomposition`), an arm of the OPW kind on a linear axis
        (`rail`), seven joints of which one can be held (`redundant`), the search (`numeric`). Its `kind` says why. Not for use from
        several threads at once.
    """
    settings = settings or IkSettings()
    rng = rng or np.random.default_rng(0)
    model = find_opw(chain)
    if isinstance(model, OpwModel):
        return ClosedFormInverse(chain, model, settings)
    linear = chain.robot.linear
    reason = ""
    if len(linear) == 6 and not any(linear):
        form = find_closed_form(chain, joint_axes(chain))
        if isinstance(form, ClosedForm):
            return SubproblemInverse(chain, form, NumericInverse(chain, settings, rng, clock))
        reason = form.reason
    rail = find_rail(chain)
    if not isinstance(rail, NotOpw):
        return RailInverse(chain, *rail, NumericInverse(chain, settings, rng, clock))
    redundant = find_redundant(chain)
    if not isinstance(redundant, NoClosedForm):
        return RedundantInverse(chain, *redundant, NumericInverse(chain, settings, rng, clock))
    return NumericInverse(chain, settings, rng, clock, reason or redundant.reason)
