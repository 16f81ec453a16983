"""Inverse kinematics of any arm behind one interface: in closed form where the arm allows it, by search where not."""

from __future__ import annotations

import numpy as np

from construction_twin.core.clock import MONOTONIC, Clock
from construction_twin.kinematics.chain import Chain
from construction_twin.kinematics.closed_form import ClosedFormInverse
from construction_twin.kinematics.numeric import NumericInverse
from construction_twin.kinematics.opw import OpwModel, find_opw
from construction_twin.kinematics.rail import RailInverse, find_rail
from construction_twin.kinematics.solution import Configuration, IkSettings, IkSolution, InverseKinematics
from construction_twin.kinematics.subproblems import ClosedForm, SubproblemInverse, find_closed_form

__all__ = ["Configuration", "IkSettings", "IkSolution", "InverseKinematics", "inverse_kinematics"]


def inverse_kinematics(
    chain: Chain,
    settings: IkSettings | None = None,
    rng: np.random.Generator | None = None,
    clock: Clock = MONOTONIC,
) -> InverseKinematics:
    """Return the inverse kinematics that fits an arm; not for use from several threads at once.

    The first that fits: `opw`, `subproblems`, `rail`, `numeric`. A search draws its starting points from `rng`, by default of a
    fixed seed, and keeps its budget by the clock [s].
    """
    settings = settings or IkSettings()
    rng = rng or np.random.default_rng(0)
    model = find_opw(chain)
    if isinstance(model, OpwModel):
        return ClosedFormInverse(chain, model, settings)
    if chain.robot.linear == (False,) * 6:
        form = find_closed_form(chain)
        if isinstance(form, ClosedForm):
            return SubproblemInverse(chain, form, NumericInverse(chain, settings, rng, clock))
        return NumericInverse(chain, settings, rng, clock, form)
    rail = find_rail(chain)
    if not isinstance(rail, str):
        return RailInverse(chain, *rail, NumericInverse(chain, settings, rng, clock))
    return NumericInverse(chain, settings, rng, clock, rail)
