"""Files that are written whole: one that cannot be finished is not begun."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from construction_twin.core.files import write_whole

ROOT = Path(__file__).resolve().parents[3]
KR120 = [
    str(ROOT / name) for name in ("urdf/kr120r2500.urdf.xacro", "config/kr120.yaml", "config/kr120_self_collision.yaml")
]
#: Runs a module's `main` with its arguments, in a process that can write 1 kB into a file: as on a disk that becomes full.
FULL = """
import importlib, resource, sys
main = importlib.import_module(sys.argv[1]).main
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
main(sys.argv[2:])
"""


@pytest.mark.parametrize(
    "command, there, target",
    [("srdf_command", "robot.srdf", "robot.srdf"), ("moveit_config_command", "kr120.srdf", "")],
)
def test_a_full_disk_leaves_the_old_file_and_nothing_else(tmp_path, command, there, target):
    (tmp_path / there).write_text("the old one")
    arguments = [f"construction_twin.scene.{command}", *KR120, str(tmp_path / target)]
    run = subprocess.run([sys.executable, "-c", FULL, *arguments], capture_output=True, text=True, timeout=60.0)
    assert run.returncode == 1 and "File too large" in run.stderr and "Traceback" not in run.stderr, run.stderr
    assert [file.name for file in tmp_path.iterdir()] == [there]
    assert (tmp_path / there).read_text() == "the old one"


def test_a_second_text_replaces_the_first_and_leaves_nothing_else(tmp_path):
    file = tmp_path / "made" / "file"
    for text in ("first", "second"):
        write_whole(file, text)
    assert file.read_text() == "second" and list(file.parent.iterdir()) == [file]


@pytest.mark.parametrize("name", ["", ".", "/"])
def test_a_folder_is_no_file(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(OSError):
        write_whole(Path(name), "text")
    assert list(tmp_path.iterdir()) == []
