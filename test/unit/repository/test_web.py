"""The console's page: its own tests, run by node, and what the built page must keep. Needs `setup/setup.sh console`."""

import gzip
import os
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from construction_twin.robot.trajectory import Trajectory

ROOT = Path(__file__).resolve().parents[3]
WEB = ROOT / "web"
PAGE = ROOT / ".ws" / "console" / "page"
NODE = ROOT / ".ws" / "console" / "node.path"
#: Most that a browser gets of script and style before it can draw, compressed [bytes].
LARGEST = 400_000

page_is_built = pytest.mark.skipif(not NODE.is_file(), reason="the page is not built: setup/setup.sh console")


@page_is_built
@pytest.mark.parametrize("file", sorted((WEB / "test").glob("*.test.js")), ids=lambda file: file.name)
def test_the_tests_of_the_page_pass(file):
    # by its own name: `--test` would start another node for it
    command, env = [NODE.read_text().strip(), str(file)], {**os.environ, "NO_COLOR": "1"}
    run = subprocess.run(command, cwd=WEB, env=env, capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stdout + run.stderr
    assert re.search(r"^(?:# |ℹ )pass [1-9]", run.stdout, re.MULTILINE), run.stdout


@page_is_built
def test_the_page_is_small_and_its_files_may_be_kept_for_ever():
    named = re.findall(r'"((?:main|style)\.[0-9A-Z]{8}\.(?:js|css))"', (PAGE / "index.html").read_text())
    assert len(named) == 2
    # what these import at once; the readers of mesh files come when an arm has such meshes
    at_first, found = set(), set(named)
    while found - at_first:
        name = (found - at_first).pop()
        at_first.add(name)
        found |= set(re.findall(r"""(?:from|import) ?["']\./([^"']+)["']""", (PAGE / name).read_text()))
    assert not any("Loader" in name for name in at_first)
    assert sum((PAGE / f"{name}.gz").stat().st_size for name in at_first) < LARGEST
    for name in (file.name for file in PAGE.iterdir() if file.suffix in (".js", ".css")):
        assert re.fullmatch(r"\w+\.[0-9A-Z]{8}\.(js|css)", name)
        assert gzip.decompress((PAGE / f"{name}.gz").read_bytes()) == (PAGE / name).read_bytes()


@page_is_built
def test_the_licences_of_other_peoples_code_are_beside_it():
    assert any("three" in licences.read_text().lower() for licences in PAGE.glob("*.LEGAL.txt"))


def test_versions_are_exact():
    package = (WEB / "package.json").read_text()
    versions = re.findall(r'"(?:three|urdf-loader|mqtt|esbuild|linkedom)": "([^"]+)"', package)
    assert len(versions) == 5
    assert all(re.fullmatch(r"[0-9]+\.[0-9]+\.[0-9]+", version) for version in versions)


def test_the_page_and_the_robots_side_hash_the_same_motion_alike():
    trajectory = Trajectory(
        ("joint_a1", "joint_a2"),
        np.array([0.0, 0.004, 1.25]),
        np.array([[0.1, -1.5], [0.1 + 1 / 3, -1.25], [0.7, -0.0]]),
        np.array([[0.0, 0.0], [1e-9, -3.0], [0.0, 0.0]]),
        np.array([[0.0, 0.0], [2.0, 2.0], [0.0, 0.0]]),
    )
    assert f'"{trajectory.content_hash()}"' in (WEB / "test" / "plan_hash.test.js").read_text()
