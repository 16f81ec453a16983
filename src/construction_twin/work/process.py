"""What is asked of a process: a way of working on an element, such as `place`.

A process is one folder beside this module, whose `process.py` has a `Process`; `process_of` finds it by its name. Its recipe says
how it is done, and which elements are worked on by it. Everything but this record is alike for each: the motions' checks, the
review, the switches, the ledger.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any

from construction_twin.core.errors import ConfigurationError
from construction_twin.robot.tool import Tool
from construction_twin.work.jobs import TaskMotions, WorkJob
from construction_twin.work.recipe import DEFAULT, Override, Recipe

#: The stage of every process at which the arm does not get there at all.
REACH = "reach"


@dataclass(frozen=True)
class Process:
    """One process.

    Attributes:
        moves: It takes the element from its stock to its place. Then the element needs a rack, lies there before, is carried in
            between, and a person is asked where it is. Else it stands at its place all the time, and a person is asked whether the
            task was carried out.
        overrides: By its name, each property of an element in the model that replaces a key of its recipe.
        check_recipe: Takes a recipe, the tool, and file and name of the recipe; raises ConfigurationError when that tool cannot do
            it.
        mass: Takes a job, name of its recipe, the recipe and the tool; returns the mass that the element is planned with [kg], or
            None where nobody says. Raises TaskPlanningError when the element cannot be planned with it.
        acts: Name of the segment at whose end it acts at the element's place.
        check: Takes a `motions.Search`; raises TaskPlanningError when job or scene are not what it needs.
        plan: Takes the same; returns the plan, or raises `motions.Failed` with the attempt that came furthest. Its segments are all
            that is drawn of it, played, and told to the ledger.
    """

    moves: bool
    recipe: type[Recipe]
    overrides: Mapping[str, Override]
    check_recipe: Callable[[Any, Tool, str], None]
    mass: Callable[[WorkJob, str, Any, Tool], float | None]
    acts: str
    check: Callable[[Any], None]
    plan: Callable[[Any], TaskMotions]


#: Module of each process; its `PROCESS` is the process.
MODULES = {DEFAULT: "construction_twin.work.place.process"}


@cache
def process_of(name: str) -> Process:
    """Return a process by its name; ConfigurationError for one that is not known."""
    if name not in MODULES:
        raise ConfigurationError("process", name, f"one of {', '.join(MODULES)}")
    return import_module(MODULES[name]).PROCESS
