"""What `pip install` and catkin read: pyproject.toml, setup.py, package.xml."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
from functools import cache
from importlib.metadata import packages_distributions
from pathlib import Path
from xml.etree import ElementTree

import pytest
import tomllib
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import construction_twin

ROOT = Path(__file__).resolve().parents[3]
PACKAGE = ROOT / "src/construction_twin"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
# fmt: off
#: What each extra is for; where an extra contains another, the folders of both.
FOLDERS = {
    "gateway": {"core", "controller", "mqtt", "rsi", "gateway"},
    "kinematics": {"core", "robot", "kinematics"},
    "evaluation": {"evaluation"},
    "planning": {
        "scene", "planning", "review", "twin", "monitor", "execution", "mock", "scenario", "servo",
        "views", "link",
    },
    "work": {"work"},
    "physics": {"physics"},
    "console": {"console", "broker"},
}
# fmt: on
#: No wheel exists: docs/library.md says where it comes from.
DEBIAN = {"PyKDL"}
#: The distribution of a module that no metadata of an installation name.
BROUGHT_BY = {"pinocchio": ["pin"], "mpl_toolkits": ["matplotlib"]}


def requirements(extra: str) -> dict[str, Requirement]:
    """Return what an extra asks for, with that of the extras that it contains, by name."""
    found: dict[str, Requirement] = {}
    for line in PROJECT["optional-dependencies"][extra]:
        requirement = Requirement(line)
        if requirement.name == PROJECT["name"]:
            for inner in requirement.extras:
                found |= requirements(inner)
        else:
            found[canonicalize_name(requirement.name)] = requirement
    return found


def pinned() -> dict[str, str]:
    """Return the versions of this project's own venv."""
    lines = [line for file in (ROOT / "setup").glob("requirements*.txt") for line in file.read_text().splitlines()]
    return {
        canonicalize_name(name): version for name, version in re.findall(r"^([\w.-]+)==(\S+)$", "\n".join(lines), re.M)
    }


@cache
def imported(folder: str) -> set[str]:
    """Return the packages outside of the standard library that the modules of a folder import."""
    found = set()
    for file in (PACKAGE / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            found |= {name.partition(".")[0] for name in names}
    return found - sys.stdlib_module_names - {"construction_twin"} - DEBIAN


@pytest.mark.parametrize("extra", FOLDERS)
def test_an_extra_brings_what_its_folders_import(extra):
    packages = packages_distributions() | BROUGHT_BY
    brought = set(requirements(extra))
    needed = set().union(*map(imported, FOLDERS[extra]))
    assert [
        name for name in sorted(needed) if brought.isdisjoint(map(canonicalize_name, packages.get(name, [name])))
    ] == []


@pytest.mark.parametrize("extra", PROJECT["optional-dependencies"])
def test_what_an_extra_allows_is_what_the_tests_run_with(extra):
    versions = pinned()
    for name, requirement in requirements(extra).items():
        # these two come from Debian here
        if name not in ("pyyaml", "rospkg"):
            assert requirement.specifier.contains(versions[name]), f"{requirement} and {versions[name]}"


@pytest.fixture(scope="module")
def metadata(tmp_path_factory) -> Path:
    """The folder with what setuptools says of the package."""
    folder = tmp_path_factory.mktemp("egg")
    command = ["/usr/bin/python3", "setup.py", "-q", "egg_info", "--egg-base", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    return folder / "construction_twin.egg-info"


def test_every_module_and_every_shared_file_is_installed(metadata):
    listed = set((metadata / "SOURCES.txt").read_text().splitlines())
    modules = {str(file.relative_to(ROOT)) for file in PACKAGE.rglob("*.py")}
    assert sorted(modules - listed) == []
    assert "src/construction_twin/py.typed" in listed
    asked = {
        name
        for file in (*PACKAGE.rglob("*.py"), ROOT / "docs/library.md")
        for name in re.findall(r"share_file\(\"([^\"]+)\"\)", file.read_text())
    }
    assert len(asked) > 5
    for name in asked:
        assert name in listed or any(each.startswith(f"{name}/") for each in listed), name


def test_the_version_is_that_of_the_package():
    assert construction_twin.__version__ == ElementTree.parse(ROOT / "package.xml").findtext("version")


def test_what_is_imported_is_pinned_or_a_dependency_of_the_package():
    """By the name of its ROS package, or by that of Debian's package, which is its rosdep key."""
    keys = {each.text for each in ElementTree.parse(ROOT / "package.xml").getroot() if each.tag.endswith("depend")}
    distributions, versions = packages_distributions() | BROUGHT_BY, pinned()
    examples = {file.stem for file in (ROOT / "examples").rglob("*.py")}
    for name in sorted((imported("") | DEBIAN) - examples):
        is_pinned = any(canonicalize_name(each) in versions for each in distributions.get(name, [name]))
        assert is_pinned or not keys.isdisjoint({name, f"python3-{name.lower()}"}), name


def test_a_workspace_of_one_s_own_gets_what_its_nodes_import(tmp_path):
    """A link in `src` and `catkin_make`, nothing else: the build makes the venv, and every node runs with it."""
    package, workspace = tmp_path / "repository", tmp_path / "workspace"
    for name in ("CMakeLists.txt", "package.xml", "setup.py", "gazebo/CMakeLists.txt", "setup/setup.sh"):
        (package / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, package / name)
    for name, text in {
        "setup/requirements.txt": "",
        "setup/requirements-no-deps.txt": "",
        "msg/One.msg": "",
        "srv/Two.srv": "---\n",
        "src/construction_twin/__init__.py": "",
        "nodes/one": "#!/usr/bin/env python3\nimport sys\n\nprint(sys.prefix)\n",
    }.items():
        (package / name).parent.mkdir(parents=True, exist_ok=True)
        (package / name).write_text(text)
    (workspace / "src").mkdir(parents=True)
    (workspace / "src/construction_twin").symlink_to(package)
    built = "catkin_make && source devel/setup.bash && rosrun construction_twin one"
    others = "gencpp;geneus;genlisp;gennodejs"
    plain = {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path), "ROS_LANG_DISABLE": others}
    run = subprocess.run(["bash", "-c", built], cwd=workspace, env=plain, capture_output=True, text=True, timeout=600)
    assert run.returncode == 0, run.stderr
    assert run.stdout.splitlines()[-1] == str(package / ".ws/venv")
