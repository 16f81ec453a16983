"""The processes by their names: the one place that names a process's folder."""

from __future__ import annotations

from functools import cache
from importlib import import_module

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.sentences import Sentence
from construction_twin.work.process import Process
from construction_twin.work.recipe import DEFAULT

#: Module of each process; its `PROCESS` is the process.
MODULES = {DEFAULT: "construction_twin.work.place.process"}


@cache
def process_of(name: str) -> Process:
    """Return a process by its name; ConfigurationError for one that is not known."""
    if name not in MODULES:
        raise ConfigurationError("process", name, Sentence("expected.one_of", known=", ".join(MODULES)))
    return import_module(MODULES[name]).PROCESS
