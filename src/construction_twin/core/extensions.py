"""The ports of the core to its extensions, each of which may be absent, or lack its packages."""

from __future__ import annotations

import importlib
import importlib.util
import signal
import sys
from pathlib import Path
from types import ModuleType

from construction_twin.core.errors import ConfigurationError

#: What setup/requirements-<group>.txt installs, by group: the names that Python imports.
PACKAGES = {
    "console": ("aiohttp",),
    "work": ("ifc4d", "ifcopenshell", "isodate", "shapely", "xerparser"),
    "physics": ("mujoco",),
}


class ExtensionAbsent(ConfigurationError):
    """An extension is missing in this installation."""


def import_extension(module: str) -> ModuleType:
    """Import a module of an extension, ``physics.mock_servo``; ExtensionAbsent where it is not installed."""
    path = f"construction_twin.extensions.{module}"
    try:
        return importlib.import_module(path)
    except ModuleNotFoundError as error:
        if not path.startswith(error.name or "-"):
            raise
        name = module.partition(".")[0]
        raise ExtensionAbsent(path, None, f"the extension {name}, which this installation is without") from error


def run_main(module: str, waits: bool = False) -> object:
    """Run `main` of an extension's program; without the extension print that and return 2, or wait as a node."""
    try:
        main = import_extension(module).main
    except ExtensionAbsent as error:
        print(error, file=sys.stderr, flush=True)
        if waits:
            signal.pause()
        return 2
    return main()


def node_modules() -> dict[str, str]:
    """Return the module of each node of core and extensions, by the node's name."""
    package = Path(__file__).parent.parent
    paths = [path.relative_to(package.parent).with_suffix("") for path in package.glob("**/nodes/*.py")]
    return {path.name: ".".join(path.parts) for path in paths if path.name != "__init__"}


def check_extras(group: str) -> None:
    """Check that a group's packages are installed, before a module imports them."""
    missing = [name for name in PACKAGES[group] if importlib.util.find_spec(name) is None]
    if missing:
        which = "it is" if len(missing) == 1 else "they are"
        raise ConfigurationError(", ".join(missing), None, f"that {which} installed; run setup/setup.sh {group}")
