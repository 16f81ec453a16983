"""The Python packages that only one group of the set-up brings, and one sentence where they are missing."""

from __future__ import annotations

import importlib.util

from construction_twin.core.errors import ConfigurationError

#: What setup/requirements-<group>.txt installs, by group: the names that Python imports.
PACKAGES = {"console": ("aiohttp",), "work": ("ifcopenshell", "isodate", "shapely"), "physics": ("mujoco",)}


def check_extras(group: str) -> None:
    """Check that a group's packages are there. To be called before a module that needs them is imported."""
    missing = [name for name in PACKAGES[group] if importlib.util.find_spec(name) is None]
    if missing:
        which = "it is" if len(missing) == 1 else "they are"
        raise ConfigurationError(", ".join(missing), None, f"that {which} installed; run setup/setup.sh {group}")
