"""The Python packages that only work from a building model needs, and one sentence where they are missing."""

from __future__ import annotations

import importlib.util

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.sentences import Sentence

#: What setup/requirements-work.txt installs.
PACKAGES = ("coacd", "ifcopenshell", "isodate", "shapely")


def check_extras() -> None:
    """Check that the packages are there. To be called before `element_bodies` or `ifc` are imported.

    Raises:
        ConfigurationError: Naming those that are missing, and what installs them.
    """
    missing = [name for name in PACKAGES if importlib.util.find_spec(name) is None]
    if missing:
        expected = Sentence("expected.work.installed" if len(missing) == 1 else "expected.work.all_installed")
        raise ConfigurationError(", ".join(missing), None, expected)
