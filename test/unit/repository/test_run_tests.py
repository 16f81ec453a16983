"""How `make test` counts results, and when it runs a test again: only after a failure beside which the machine itself stood still."""

from __future__ import annotations

import pytest
import run_tests  # noqa: E402


class Probe:
    """Says of each run how long the machine stood still [ms]."""

    def __init__(self, *pauses: float, above: bool = True):
        self._answers = [answer for pause in pauses for answer in (0.0, pause)]
        self._above = above

    def taken(self) -> dict:
        return {"longest_ms": self._answers.pop(0), "above": self._above}


class Runs:
    """Runs of one test; each result is (passed, failed)."""

    def __init__(self, *results: tuple[int, int]):
        self.results, self.made = results, 0

    def __call__(self) -> tuple[int, int]:
        passed, failed = self.results[self.made]
        self.made += 1
        run_tests.FAILED.extend(f"failure {self.made}" for _ in range(failed))
        return passed, failed


@pytest.fixture(autouse=True)
def earlier(monkeypatch):
    """What failed before is kept whatever happens."""
    monkeypatch.setattr(run_tests, "FAILED", ["earlier"])
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
    assert run_tests.count(file) == expected


def test_takes_a_missing_result_file_for_a_failure(tmp_path):
    assert run_tests.count(tmp_path / "none.xml") == (0, 1)


def test_remembers_which_tests_failed_and_why(tmp_path, monkeypatch):
    monkeypatch.setattr(run_tests, "FAILED", [])
    cases = (
        '<testcase classname="a.B" name="good"/>'
        '<testcase classname="a.B" name="bad"><failure message="0.2 is not less than 0.1&#10;more"/></testcase>'
        '<testcase classname="a.B" name="ugly"><error>Traceback</error></testcase>'
    )
    file = tmp_path / "result.xml"
    file.write_text(f'<testsuites><testsuite tests="3" failures="1" errors="1">{cases}</testsuite></testsuites>')
    run_tests.count(file)
    run_tests.count(tmp_path / "none.xml")
    assert run_tests.FAILED[:2] == ["a.B.bad: 0.2 is not less than 0.1", "a.B.ugly: Traceback"]
    assert "none.xml" in run_tests.FAILED[2]


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
    assert run_tests.undisturbed("a", runs, Probe(run_tests.HALT - 0.1)) == (3, 1)
    assert (runs.made, run_tests.FAILED) == (1, ["earlier", "failure 1"])


def test_a_failure_beside_a_pause_is_told_and_the_next_run_counts(capsys):
    runs = Runs((3, 1), (2, 2))
    assert run_tests.undisturbed("a.test", runs, Probe(120.0, 0.0)) == (2, 2)
    assert (runs.made, run_tests.FAILED) == (2, ["earlier", "failure 2", "failure 2"])
    told = capsys.readouterr().out
    assert "DISTURBED a.test" in told and "120 ms" in told and "not counted: failure 1" in told
    assert run_tests.DISTURBED == ["a.test"]


def test_a_probe_that_our_own_load_keeps_waiting_excuses_nothing():
    runs = Runs((3, 1))
    assert run_tests.undisturbed("a", runs, Probe(500.0, above=False)) == (3, 1)
    assert (runs.made, run_tests.DISTURBED) == (1, [])


def test_a_success_counts_whatever_the_machine_did():
    runs = Runs((4, 0))
    assert run_tests.undisturbed("a", runs, Probe(500.0)) == (4, 0)
    assert (runs.made, run_tests.FAILED) == (1, ["earlier"])


def test_a_machine_that_never_runs_ends_in_a_failure():
    attempts = run_tests.AGAIN + 1
    runs = Runs(*[(3, 1)] * attempts)
    assert run_tests.undisturbed("a", runs, Probe(*[500.0] * attempts)) == (3, 1)
    assert (runs.made, run_tests.FAILED) == (attempts, ["earlier", f"failure {attempts}"])
