"""Inverse kinematics of any arm behind one interface: in closed form where the arm allows it, by search where not.

Users of solutions import from here; the classes behind are chosen by the arm's geometry.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np

from construction_twin.kinematics.axes import joint_axes
from construction_twin.kinematics.chain import Chain
from construction_twin.kinematics.closed_form import ClosedFormInverse
from construction_twin.kinematics.decomposition import ClosedForm, find_closed_form
from construction_twin.kinematics.numeric import NumericInverse
from construction_twin.kinematics.opw import NotOpw, OpwModel, find_opw
from construction_twin.kinematics.rail import RailInverse, find_rail
from construction_twin.kinematics.solution import Configuration, IkSettings, IkSolution, InverseKinematics
from construction_twin.kinematics.subproblems import SubproblemInverse

__all__ = ["Configuration", "IkSettings", "IkSolution", "InverseKinematics", "inverse_kinematics"]

_LOG = logging.getLogger(__name__)


def inverse_kinematics(
    chain: Chain, settings: IkSettings, rng: np.random.Generator, clock: Callable[[], float]
) -> InverseKinematics:
    """Return the inverse kinematics that fits an arm.

    Parameters
    ----------
    chain : Chain
    settings : IkSettings
    rng : numpy Generator
        Source of the search's starting points.
    clock : callable
        Returns the present time [s], e.g. ``time.monotonic``: for the search's budget.

    Returns
    -------
    inverse : InverseKinematics
        In closed form if `opw.find_opw` says that the arm is of that kind, or `rail.find_rail` that it stands on a linear
        axis. Not for use from several threads at once.
    """
    model = find_opw(chain)
    if isinstance(model, OpwModel):
        return ClosedFormInverse(chain, model, settings)
    search = NumericInverse(chain, settings, rng, clock)
    form = find_closed_form(chain, joint_axes(chain)) if not any(chain.robot.linear) else None
    if isinstance(form, ClosedForm):
        return SubproblemInverse(chain, form, search)
    rail = find_rail(chain)
    if isinstance(rail, NotOpw):
        _LOG.info("%s: inverse kinematics by search, because %s", chain.robot.name, model.reason)
        return search
    return RailInverse(chain, ClosedFormInverse(*rail, settings), search)
