"""The makes of controller by their names: the one place that names a make's folder."""

from __future__ import annotations

from functools import cache
from importlib import import_module

from construction_twin.controller.port import Make
from construction_twin.core.errors import ConfigurationError

#: The make of a configuration that names none.
DEFAULT = "rsi"
#: Module of each make; its `MAKE` is the make.
MODULES = {DEFAULT: "construction_twin.rsi.make"}


@cache
def make_of(name: str) -> Make:
    """Return a make by its name; ConfigurationError for an unknown one."""
    if name not in MODULES:
        raise ConfigurationError("make", name, f"one of {', '.join(MODULES)}")
    return import_module(MODULES[name]).MAKE
