"""Files that are written whole: one that cannot be finished is not begun."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from construction_twin.core.files import write_atomically

#: Writes a file in a process that can write 1 kB into one: as on a disk that becomes full.
FULL = """
import pathlib, resource, sys
from construction_twin.core.files import write_atomically
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
write_atomically(pathlib.Path(sys.argv[1]), 2000 * "a")
"""


def test_a_full_disk_leaves_the_old_file_and_nothing_else(tmp_path):
    file = tmp_path / "robot.yaml"
    file.write_text("the old one")
    run = subprocess.run([sys.executable, "-c", FULL, str(file)], capture_output=True, text=True, timeout=60.0)
    assert run.returncode == 1 and "OSError: [Errno 27] File too large" in run.stderr, run.stderr
    assert list(tmp_path.iterdir()) == [file] and file.read_text() == "the old one"


def test_a_second_text_replaces_the_first_and_leaves_nothing_else(tmp_path):
    file = tmp_path / "made" / "file"
    for text in ("first", "second"):
        write_atomically(file, text)
    assert file.read_text() == "second" and list(file.parent.iterdir()) == [file]


@pytest.mark.parametrize("name", ["", ".", "/"])
def test_a_folder_is_no_file(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(OSError):
        write_atomically(Path(name), "text")
    assert list(tmp_path.iterdir()) == []
