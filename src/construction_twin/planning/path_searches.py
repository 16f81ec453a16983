"""The searches for a path, by name. Another one is a module with a class as `path_search.PathSearch` asks, and a line here."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.sentences import Sentence
from construction_twin.planning.ompl_search import OmplSearch, ompl_planners
from construction_twin.planning.path_search import PathSearch


def path_searches() -> dict[str, Callable[[], PathSearch]]:
    """Return what makes each search, by the name that the planner's settings give it."""
    return {name: partial(OmplSearch, name, kind) for name, kind in ompl_planners().items()}


def path_search(name: str) -> PathSearch:
    """Return a search by its name.

    Raises:
        ConfigurationError: If there is none of that name; lists what there is.
    """
    known = path_searches()
    if name not in known:
        raise ConfigurationError("the planner", name, Sentence("expected.one_of", known=", ".join(known)))
    return known[name]()
