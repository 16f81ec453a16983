"""How `make test` counts results, and when it runs a test again: only if it failed while the machine itself stood still."""

from __future__ import annotations

import dataclasses
import os
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import durations
import lint
import pytest
import run_tests
import touched
from run_tests import Result

ROOT = Path(__file__).resolve().parents[3]


class Probe:
    """Says of each run how long the machine stood still [ms]."""

    def __init__(self, *pauses: float, above: bool = True):
        self._answers = [answer for pause in pauses for answer in (0.0, pause)]
        self._above = above

    def taken(self) -> dict:
        return {"longest_ms": self._answers.pop(0), "above": self._above}


class Runs:
    """Runs of one test; each is (passed, failed)."""

    def __init__(self, *runs: tuple[int, int]):
        self.results = [
            Result(passed, failed, (f"failure {number}",) * failed) for number, (passed, failed) in enumerate(runs, 1)
        ]
        self.made = 0

    def __call__(self) -> Result:
        self.made += 1
        return self.results[self.made - 1]


@pytest.fixture(autouse=True)
def first_run(monkeypatch):
    """Nothing has been run again before."""
    monkeypatch.setattr(run_tests, "DISTURBED", [])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('<testsuite tests="3" failures="0" errors="0"/>', (3, 0)),
        ('<testsuites><testsuite tests="5" failures="1" errors="1" skipped="1"/></testsuites>', (2, 2)),
        ('<testsuite tests="0" failures="0" errors="0"/>', (0, 1)),
        ("not xml", (0, 1)),
    ],
)
def test_counts_a_result_file_and_takes_an_empty_or_broken_one_for_a_failure(tmp_path, text, expected):
    file = tmp_path / "result.xml"
    file.write_text(text)
    result = run_tests.count(file)
    assert (result.passed, result.failed) == expected


def test_takes_a_missing_result_file_for_a_failure(tmp_path):
    result = run_tests.count(tmp_path / "none.xml")
    assert (result.passed, result.failed) == (0, 1) and "none.xml" in result.failures[0]


def test_says_which_tests_failed_and_why(tmp_path):
    cases = (
        '<testcase classname="a.B" name="good"/>'
        '<testcase classname="a.B" name="bad"><failure message="0.2 is not less than 0.1&#10;more"/></testcase>'
        '<testcase classname="a.B" name="ugly"><error>Traceback</error></testcase>'
    )
    file = tmp_path / "result.xml"
    file.write_text(f'<testsuites><testsuite tests="3" failures="1" errors="1">{cases}</testsuite></testsuites>')
    total = Result.total([run_tests.count(file), run_tests.count(tmp_path / "none.xml")])
    assert total.failures[:2] == ("a.B.bad: 0.2 is not less than 0.1", "a.B.ugly: Traceback")
    assert "none.xml" in total.failures[2]


def test_every_tool_of_lint_counts_as_one_test(capsys):
    findings = [
        lint.Finding("ruff check", True, "All checks passed!"),
        lint.Finding("mypy", False, "a.py:1: x\n1 error\n"),
    ]
    assert run_tests.count_lint(findings) == Result(1, 1, ("lint, mypy: 1 error",))
    told = capsys.readouterr().out
    assert "a.py:1: x" in told and "All checks passed!" not in told
    assert run_tests.count_lint([]) == Result()


@pytest.mark.parametrize(("program", "passed"), [("true", True), ("false", False)])
def test_a_tool_passes_if_its_program_says_so(program, passed, monkeypatch):
    monkeypatch.setattr(lint, "BIN", Path("/usr/bin"))
    monkeypatch.setattr(lint, "TOOLS", {"a tool": (program,)})
    (finding,) = lint.end(lint.start())
    assert (finding.name, finding.passed) == ("a tool", passed)


def test_lint_finds_an_import_against_the_order_of_the_folders(tmp_path):
    """The contract is read and enforced: a copy of the package in which core imports numpy and the robot is refused."""
    shutil.copytree(ROOT / "src", tmp_path / "src")
    shutil.copy(ROOT / ".importlinter", tmp_path)
    with open(tmp_path / "src/construction_twin/core/units.py", "a") as file:
        file.write("\nimport construction_twin.robot.frames\n")
    run = subprocess.run(
        [lint.BIN / "lint-imports", "--no-logo", "--no-cache"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(tmp_path / "src")},
        capture_output=True,
        text=True,
    )
    assert run.returncode != 0
    assert "Each folder imports only from those below it BROKEN" in run.stdout
    assert "The cell folders need the standard library and paho only BROKEN" in run.stdout


def test_every_unit_test_is_run_once():
    alone, beside = run_tests.unit_files()
    assert sorted(alone + beside) == sorted((ROOT / "test/unit").rglob("test_*.py"))
    assert {"test_gateway_program", "test_fuzz"} <= {file.stem for file in alone}


def test_without_a_word_everything_is_selected():
    chosen, (alone, beside) = run_tests.select([]), run_tests.unit_files()
    assert (chosen.lint, chosen.beside, chosen.alone, chosen.browser) == (True, beside, alone, [ROOT / "test/browser"])
    assert chosen.integration == sorted((ROOT / "test/integration").glob("*.test"))


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (["lint"], {"lint"}),
        (["unit"], {"beside", "alone"}),
        (["browser"], {"browser"}),
        (["unit", "lint"], {"lint", "beside", "alone"}),
        (["bringup"], {"integration"}),
        (["fast"], {"beside"}),
        (["fast", "lint"], {"lint", "beside"}),
    ],
)
def test_a_word_selects_its_part(words, parts):
    chosen = run_tests.select(words)
    assert {field.name for field in dataclasses.fields(chosen) if getattr(chosen, field.name)} == parts


def test_a_name_selects_the_launch_test_of_that_name():
    assert [test.name for test in run_tests.select(["bringup", "kill"]).integration] == ["bringup.test", "kill.test"]


def test_a_change_selects_what_it_touches_and_lint(monkeypatch):
    asked = []
    found = [
        "test/browser/test_login.py",
        "test/integration/kill.test",
        "test/unit/core/test_limits.py",
        "test/unit/repository/test_fuzz.py",
    ]
    monkeypatch.setattr(touched, "touched_by_a_change", lambda since: asked.append(since) or found)
    chosen = run_tests.select(["changed=abc"])
    assert asked == ["abc"] and chosen.lint
    files = [*chosen.browser, *chosen.integration, *chosen.beside, *chosen.alone]
    assert [file.relative_to(ROOT).as_posix() for file in files] == found


def test_a_file_of_tests_stays_in_one_process_and_tells_what_it_took(tmp_path):
    """Its tests may share a broker, a port, or what a fixture made."""
    lines = [
        "import os",
        "import pytest",
        "@pytest.mark.parametrize('n', range(6))",
        "def test_it(n, record_property):",
        "    record_property('process', os.getpid())",
    ]
    for name in ("test_a.py", "test_b.py"):
        (tmp_path / name).write_text("\n".join(lines))
    result = tmp_path / "result.xml"
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-n", "2", *run_tests.IN_ORDER]
    command += [*run_tests.BY_FILE, f"--junitxml={result}", str(tmp_path)]
    subprocess.run(command, cwd=tmp_path, check=True, stdout=subprocess.DEVNULL, timeout=200)
    processes: dict[str, set[str]] = {}
    for case in ElementTree.parse(result).iter("testcase"):
        processes.setdefault(case.get("file"), set()).add(case.find("properties/property").get("value"))
    assert {len(each) for each in processes.values()} == {1} and len(processes) == 2
    assert {Path(name).name for name in durations.of_junit(result)} == {"test_a.py", "test_b.py"}


def test_every_file_of_launch_tests_is_started_by_a_rostest():
    folder = ROOT / "test/integration"
    started = [name for test in folder.glob("*.test") for name in touched.started_by(test.read_text())]
    held = {file.name for file in folder.glob("*.py") if "rostest.rosrun(" in file.read_text()}
    assert held == set(started)
    # one that is brought up twice would cost its time twice; the scenarios differ in their arguments
    twice = {name for name in started if started.count(name) > 1}
    assert twice == {"together.py", "test_scenario.py"}


def test_what_a_rostest_reports_is_shown(tmp_path):
    file = tmp_path / "rosunit-x.xml"
    file.write_text(
        '<testsuite tests="1"><testcase name="a"/><system-out>&lt;![CDATA[\nHOLDON: 12 deg/s\n\n]]&gt;</system-out></testsuite>'
    )
    assert run_tests.said(file) == ["HOLDON: 12 deg/s"]
    file.write_text("not xml")
    assert run_tests.said(file) == []


def test_a_failure_on_a_machine_that_ran_counts():
    runs = Runs((3, 1))
    assert run_tests.undisturbed("a", runs, Probe(run_tests.HALT - 0.1)) == Result(3, 1, ("failure 1",))
    assert runs.made == 1


def test_a_failure_beside_a_pause_is_told_and_the_next_run_counts(capsys):
    runs = Runs((3, 1), (2, 2))
    assert run_tests.undisturbed("a.test", runs, Probe(120.0, 0.0)) == Result(2, 2, ("failure 2", "failure 2"))
    assert runs.made == 2
    told = capsys.readouterr().out
    assert "DISTURBED a.test" in told and "120 ms" in told and "not counted: failure 1" in told
    assert run_tests.DISTURBED == ["a.test"]


def test_a_probe_that_our_own_load_keeps_waiting_excuses_nothing():
    runs = Runs((3, 1))
    assert run_tests.undisturbed("a", runs, Probe(500.0, above=False)).failed == 1
    assert (runs.made, run_tests.DISTURBED) == (1, [])


def test_a_success_counts_whatever_the_machine_did():
    runs = Runs((4, 0))
    assert run_tests.undisturbed("a", runs, Probe(500.0)) == Result(4)
    assert runs.made == 1


def test_a_machine_that_never_runs_ends_in_a_failure():
    attempts = run_tests.AGAIN + 1
    runs = Runs(*[(3, 1)] * attempts)
    last = run_tests.undisturbed("a", runs, Probe(*[500.0] * attempts))
    assert (runs.made, last.failures) == (attempts, (f"failure {attempts}",))


def test_what_runs_at_250_hz_has_a_core_to_itself_and_every_file_is_run(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(run_tests, "RESULTS", tmp_path)
    monkeypatch.setattr(run_tests, "TOOK", {})
    monkeypatch.setattr(durations, "ROOT", tmp_path)
    lines = [
        "import os",
        "def test_it(record_property):",
        "    record_property('cores', sorted(os.sched_getaffinity(0)))",
        "    assert 'bad' not in __file__",
    ]
    files = [tmp_path / f"test_{name}.py" for name in ("one", "two", "bad", "three")]
    for file in files:
        file.write_text("\n".join(lines))
    total = Result.total(run_tests.run_alone(files))
    assert (total.passed, total.failed) == (3, 1) and "test_bad.test_it" in total.failures[0]
    cores = [
        ElementTree.parse(tmp_path / f"unit_{file.stem}.xml").find(".//property[@name='cores']").get("value")
        for file in files
    ]
    assert {int(core.strip("[]")) for core in cores} <= os.sched_getaffinity(0)
