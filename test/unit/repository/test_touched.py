"""Which tests a change touches: by imports, by the names of files in texts, by folders, by messages."""

from __future__ import annotations

import subprocess

import pytest
import touched
from touched import Graph

SOURCES = {
    "src/construction_twin/__init__.py": "",
    "src/construction_twin/core/__init__.py": "",
    "src/construction_twin/core/units.py": "",
    "src/construction_twin/robot/__init__.py": (
        "if TYPE_CHECKING:\n    from construction_twin.robot.frames import Frame\nelse:\n    __getattr__ = lazy(__name__)"
    ),
    "src/construction_twin/robot/plan.py": "",
    "src/construction_twin/robot/frames.py": "from construction_twin.core import units",
    "src/construction_twin/gateway/__init__.py": "",
    "src/construction_twin/gateway/__main__.py": "import construction_twin.core.units",
    "src/construction_twin/ros/__init__.py": "",
    "src/construction_twin/ros/bridge.py": "def f():\n    from construction_twin.msg import Sync",
    "msg/Sync.msg": "",
    "msg/Link.msg": "",
    "config/kr120.yaml": "",
    "config/work/panel.yaml": "",
    "docs/planning.md": "",
    "docs/reference/states.md": "",
    "test/support/cell.py": "from construction_twin.robot.frames import x",
    "test/unit/conftest.py": "",
    "test/unit/mock/conftest.py": "import cell",
    "test/unit/core/test_units.py": "import construction_twin.core.units",
    "test/unit/robot/test_frames.py": "import cell",
    "test/unit/robot/test_folder.py": "from construction_twin.robot import Frame",
    "test/unit/robot/test_plan.py": "from construction_twin.robot.plan import Plan",
    "test/unit/mock/test_mock.py": "",
    "test/unit/ros/test_bridge.py": "from construction_twin.ros import bridge",
    "test/unit/gateway/test_program.py": "run('-m', 'construction_twin.gateway')",
    "test/unit/robot/test_config.py": "read('kr120.yaml')",
    "test/unit/repository/test_docs.py": "sorted((ROOT / 'docs').rglob('*.md'))",
    "test/unit/repository/test_planning.py": "(ROOT / 'docs' / 'planning.md').read_text()",
    "test/unit/repository/test_names.py": "'''It says docs/planning.md.'''\nTESTS = ROOT / 'test/unit/mock'",
    "test/browser/test_page.py": "",
    "test/integration/kill.test": '<launch><test type="test_kill.py"/></launch>',
    "test/integration/test_kill.py": "import client\nimport construction_twin.core.units",
    "test/integration/client.py": "",
    "test/integration/both.test": '<launch><test type="together.py" args="test_view test_stall"/></launch>',
    "test/integration/together.py": "",
    "test/integration/test_view.py": "",
    "test/integration/test_stall.py": "",
}


@pytest.fixture
def graph(tmp_path) -> Graph:
    for path, text in SOURCES.items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text)
    return Graph(SOURCES, tmp_path)


@pytest.mark.parametrize(
    ("changed", "tests"),
    [
        # over what imports it, in the package and in test/support; a program that is run, too
        (
            "src/construction_twin/core/units.py",
            {"core/test_units", "robot/test_frames", "robot/test_folder", "mock/test_mock", "gateway/test_program"},
        ),
        # a folder may hand out names of any of its modules; who imports another module of it has loaded none of them
        ("src/construction_twin/robot/frames.py", {"robot/test_frames", "robot/test_folder", "mock/test_mock"}),
        ("test/support/cell.py", {"robot/test_frames", "mock/test_mock"}),
        # a message is imported from a module that is made from its file; the import stands inside of a function
        ("msg/Sync.msg", {"ros/test_bridge"}),
        ("msg/Link.msg", set()),
        ("config/kr120.yaml", {"robot/test_config"}),
        ("docs/planning.md", {"repository/test_docs", "repository/test_planning"}),
        ("docs/reference/states.md", {"repository/test_docs"}),
        # whoever reads a folder of tests is touched by them, and not by what they import
        ("test/unit/mock/test_mock.py", {"mock/test_mock", "repository/test_names"}),
    ],
)
def test_a_change_touches_what_leads_to_it(graph, changed, tests):
    assert set(touched.touched([changed], graph)) == {f"test/unit/{name}.py" for name in tests}


def test_a_deleted_module_touches_who_imports_it(graph, tmp_path):
    (tmp_path / "src/construction_twin/core/units.py").unlink()
    assert "test/unit/core/test_units.py" in touched.touched(["src/construction_twin/core/units.py"], graph)


@pytest.mark.parametrize("changed", ["pyproject.toml", "setup/requirements.txt", "test/unit/conftest.py"])
def test_how_tests_are_run_touches_every_unit_test(graph, changed):
    units = {path for path in SOURCES if path.startswith("test/unit/") and touched.is_test(path)}
    assert units == set(touched.touched([changed], graph))


def test_a_change_of_the_page_touches_its_tests(graph):
    assert touched.touched(["web/src/app.js"], graph) == ["test/browser/test_page.py"]


@pytest.mark.parametrize("changed", ["client.py", "test_kill.py", "kill.test"])
def test_a_launch_test_is_touched_by_its_own_files(graph, changed):
    assert touched.touched([f"test/integration/{changed}"], graph) == ["test/integration/kill.test"]


@pytest.mark.parametrize("changed", ["together.py", "test_view.py", "test_stall.py", "both.test"])
def test_a_launch_test_of_several_files_is_touched_by_each(graph, changed):
    assert touched.touched([f"test/integration/{changed}"], graph) == ["test/integration/both.test"]


def test_the_files_that_changed_are_those_since_a_commit_and_the_new_ones(tmp_path, monkeypatch):
    monkeypatch.setattr(touched, "ROOT", tmp_path)
    git = ["git", "-c", "user.name=t", "-c", "user.email=t@example.org"]
    subprocess.run([*git, "init", "-q"], cwd=tmp_path, check=True)
    for name in ("a.py", "b.py", "c.py"):
        (tmp_path / name).write_text(name)
        subprocess.run([*git, "add", "."], cwd=tmp_path, check=True)
        subprocess.run([*git, "commit", "-q", "-m", name], cwd=tmp_path, check=True)
    # nothing differs: the last commit is the change
    assert touched.changed_files() == ("HEAD~1", ["c.py"])
    assert touched.changed_files("HEAD~2") == ("HEAD~2", ["b.py", "c.py"])
    (tmp_path / "a.py").unlink()
    (tmp_path / "d.py").write_text("")
    assert touched.changed_files() == ("HEAD", ["a.py", "d.py"])


def test_the_repository_itself_is_read():
    graph = Graph(touched.git("ls-files"))
    gate = "test/unit/monitor/test_gate.py"
    assert gate in touched.touched(["src/construction_twin/monitor/gate.py"], graph)
    # a module far away from the gate does not touch its tests
    assert gate not in touched.touched(["src/construction_twin/work/task_board.py"], graph)
    assert "test/unit/repository/test_launch.py" in touched.touched(["launch/bringup.launch"], graph)
