"""The process `place` for `processes`. It is loaded where the ledger is kept, too, and so loads its planner when it plans."""

from __future__ import annotations

from typing import Any

from construction_twin.work.jobs import TaskMotions
from construction_twin.work.place.planner import SET_DOWN
from construction_twin.work.place.recipe import OVERRIDES, PlaceRecipe, check_tool, mass_of
from construction_twin.work.process import Process


def _check(search: Any) -> None:
    from construction_twin.work.place.planner import check

    check(search)


def _plan(search: Any) -> TaskMotions:
    from construction_twin.work.place.planner import plan

    return plan(search)


PROCESS = Process(
    moves=True,
    recipe=PlaceRecipe,
    overrides=OVERRIDES,
    check_recipe=check_tool,
    mass=mass_of,
    acts=SET_DOWN,
    check=_check,
    plan=_plan,
)
