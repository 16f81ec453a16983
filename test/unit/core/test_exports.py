"""What a folder's `__init__` offers: loaded when asked for, and nothing before."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[3] / "src/construction_twin"
FOLDERS = sorted(
    ".".join(("construction_twin", *file.parent.relative_to(PACKAGE).parts))
    for file in PACKAGE.rglob("__init__.py")
    if "lazy_exports" in file.read_text()
)
#: Imports every folder that is named, one after the other, and prints which modules each has loaded.
LOADED_BY = """
import importlib, json, sys
loaded = {}
for name in sys.argv[1:]:
    before = set(sys.modules)
    importlib.import_module(name)
    loaded[name] = sorted(set(sys.modules) - before)
print(json.dumps(loaded))
"""
#: Asks for a name whose module needs a library that is not there.
WITHOUT_NUMPY = """
import sys
sys.modules["numpy"] = None
import construction_twin.kinematics as kinematics
try:
    kinematics.Chain
except ModuleNotFoundError as error:
    print(error.name, error, sep="|")
"""


def run(code: str, *arguments: str) -> str:
    """Return what a fresh interpreter prints."""
    return subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=True, timeout=60.0
    ).stdout


@pytest.fixture(scope="module")
def loaded() -> dict[str, list[str]]:
    return json.loads(run(LOADED_BY, *FOLDERS))


def test_every_folder_but_those_of_programs_has_exports():
    assert len(FOLDERS) > 20
    without = {"construction_twin", *(f"construction_twin.ros{inside}" for inside in ("", ".nodes", ".commands"))}
    every = {
        ".".join(("construction_twin", *p.parent.relative_to(PACKAGE).parts)) for p in PACKAGE.rglob("__init__.py")
    }
    assert every - set(FOLDERS) == without


@pytest.mark.parametrize("folder", FOLDERS)
def test_importing_a_folder_loads_none_of_its_modules_and_no_library(loaded, folder):
    above = {folder.rsplit(".", depth)[0] for depth in range(folder.count(".") + 1)}
    own = above | {"construction_twin.core", "construction_twin.core.exports"}
    others = {name for name in loaded[folder] if name.partition(".")[0] not in sys.stdlib_module_names}
    assert sorted(others - own) == []


@pytest.mark.parametrize("folder", FOLDERS)
def test_every_name_that_a_folder_offers_is_there_and_is_no_module(folder):
    module = importlib.import_module(folder)
    modules = {file.stem for file in Path(module.__file__).parent.iterdir()}
    assert module.__all__ and set(module.__all__) <= set(dir(module))
    for name in module.__all__:
        # a module of the same name would take its place as soon as it is imported
        assert getattr(module, name) is not None and name not in modules


def test_a_name_that_was_asked_for_is_found_at_once_the_next_time():
    import construction_twin.core as core

    assert core.braking_step is vars(core)["braking_step"]


def test_a_name_that_is_not_offered_is_an_attribute_error():
    import construction_twin.core as core

    with pytest.raises(AttributeError, match="module 'construction_twin.core' has no attribute 'nothing'"):
        core.nothing
    with pytest.raises(ImportError, match="cannot import name 'nothing'"):
        exec("from construction_twin.core import nothing")


def test_a_library_that_is_missing_is_named_with_the_page_that_helps():
    missing, told = run(WITHOUT_NUMPY).strip().split("|")
    assert missing == "numpy"
    assert (
        told
        == "construction_twin.kinematics.Chain needs numpy, which is not installed; docs/library.md says what brings it"
    )
