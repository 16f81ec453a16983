"""The Python packages that only one group of the set-up brings, and one sentence where they are missing."""

from __future__ import annotations

import importlib.util

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.sentences import Sentence

#: What setup/requirements-<group>.txt installs, by group: the names that Python imports.
PACKAGES = {
    "work": ("coacd", "ifcopenshell", "isodate", "shapely"),
    "physics": ("mujoco",),
}


def check_extras(group: str) -> None:
    """Check that a group's packages are there. To be called before a module that needs them is imported."""
    missing = [name for name in PACKAGES[group] if importlib.util.find_spec(name) is None]
    if missing:
        expected = "expected.extras.installed" if len(missing) == 1 else "expected.extras.all_installed"
        raise ConfigurationError(", ".join(missing), None, Sentence(expected, group=group))
