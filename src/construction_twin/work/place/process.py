"""The process `place` for `work.process`."""

from __future__ import annotations

from construction_twin.work.place.planner import SET_DOWN, check, plan
from construction_twin.work.place.recipe import OVERRIDES, PlaceRecipe, check_tool, mass_of
from construction_twin.work.process import Process

PROCESS = Process(
    moves=True,
    recipe=PlaceRecipe,
    overrides=OVERRIDES,
    check_recipe=check_tool,
    mass=mass_of,
    acts=SET_DOWN,
    check=check,
    plan=plan,
)
