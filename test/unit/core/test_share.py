"""Where the package's files are, in a checkout and where it is installed."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from construction_twin.core.share import share_file, share_folder

ROOT = Path(__file__).resolve().parents[3]


def test_in_a_checkout_they_are_the_repository_s():
    assert share_folder() == ROOT
    assert share_file("config/kr120.yaml") == ROOT / "config/kr120.yaml"


def lay_out(modules: Path) -> None:
    """Copy what is needed to ask, as an installation has it."""
    (modules / "construction_twin/core").mkdir(parents=True)
    for name in ("__init__.py", "core/__init__.py", "core/share.py"):
        shutil.copy(ROOT / "src/construction_twin" / name, modules / "construction_twin" / name)


def asked_in(modules: Path) -> Path:
    code = "from construction_twin.core.share import share_folder; print(share_folder())"
    command = [sys.executable, "-E", "-S", "-c", f"import sys; sys.path.insert(0, {str(modules)!r}); {code}"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd="/")
    return Path(done.stdout.strip())


@pytest.mark.parametrize(
    "modules", ["lib/python3.11/site-packages", "lib/python3/dist-packages", "Lib/site-packages", "."]
)
def test_installed_they_are_in_share_of_the_same_place(tmp_path, modules):
    """Of a venv or a user, of a catkin install space, on Windows, and after ``pip install --target``."""
    lay_out(tmp_path / modules)
    shared = tmp_path / "share/construction_twin"
    shared.mkdir(parents=True)
    (shared / "package.xml").write_text("<package/>")
    assert asked_in(tmp_path / modules) == shared


def test_modules_alone_name_the_place_where_a_checkout_has_them(tmp_path):
    lay_out(tmp_path / "src")
    assert asked_in(tmp_path / "src") == tmp_path
