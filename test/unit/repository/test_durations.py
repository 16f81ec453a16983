"""What tests took is kept by the run itself; it decides the order in which they are run, and which of them are fast."""

from __future__ import annotations

import json
from pathlib import Path

import durations
import pytest

ROOT = Path(__file__).resolve().parents[3]
GATE, LAUNCH, LIMITS, STATES = (
    ROOT / "test/unit" / name
    for name in ("monitor/test_gate.py", "repository/test_launch.py", "core/test_limits.py", "monitor/test_states.py")
)


@pytest.fixture(autouse=True)
def kept(tmp_path, monkeypatch):
    monkeypatch.setattr(durations, "KEPT", tmp_path / "kept.json")
    monkeypatch.setattr(durations, "SHIPPED", tmp_path / "shipped.json")
    return tmp_path / "kept.json"


def name(file: Path) -> str:
    return file.relative_to(ROOT).as_posix()


def test_what_a_run_took_is_kept_beside_what_was_known():
    durations.keep({name(GATE): 3.0, name(LIMITS): 1.0})
    durations.keep({name(GATE): 4.004})
    assert durations.kept() == {name(GATE): 4.0, name(LIMITS): 1.0}


def test_a_file_that_is_gone_is_forgotten():
    durations.keep({"test/unit/core/test_gone.py": 3.0, name(GATE): 1.0})
    assert durations.kept() == {name(GATE): 1.0}


def test_what_is_shipped_counts_until_it_was_run_here(tmp_path):
    durations.keep({name(GATE): 3.0, name(LIMITS): 1.2, name(LAUNCH): 90.4})
    durations.ship()
    assert (tmp_path / "shipped.json").read_text() == f'{{\n "{name(GATE)}": 3,\n "{name(LAUNCH)}": 90\n}}\n'
    (tmp_path / "kept.json").unlink()
    durations.keep({name(GATE): 5.0})
    assert durations.kept() == {name(GATE): 5.0, name(LAUNCH): 90.0}


@pytest.mark.parametrize("text", ["", "{", "[1]", "null"])
def test_what_cannot_be_read_counts_as_never_measured(kept, text):
    kept.write_text(text)
    assert durations.kept() == {}


def test_a_result_file_is_read_by_file_with_what_its_fixtures_took(tmp_path):
    file = tmp_path / "result.xml"
    cases = [("a.py", "1.5"), ("b.py", "0.25"), ("a.py", "2.0")]
    lines = [f'<testcase name="t" file="test/unit/{name}" time="{time}"/>' for name, time in cases]
    file.write_text(f"<testsuites><testsuite>{''.join(lines)}</testsuite></testsuites>")
    assert durations.of_junit(file) == {"test/unit/a.py": 3.5, "test/unit/b.py": 0.25}
    file.write_text("not xml")
    assert durations.of_junit(file) == {}


def test_the_longest_comes_first_and_what_is_unknown_between():
    durations.keep({name(LIMITS): 0.1, name(LAUNCH): 99.0})
    assert durations.longest_first([GATE, LIMITS, LAUNCH]) == [LAUNCH, GATE, LIMITS]


def test_what_starts_a_program_is_not_fast_however_short_it_is():
    durations.keep({name(LAUNCH): 0.1})
    assert durations.fast([LAUNCH, GATE]) == [GATE]


def test_what_a_module_of_support_starts_counts():
    # a broker, by test/support/site_broker.py
    assert not durations.starts_nothing(ROOT / "test/unit/mqtt/test_acl.py")
    assert durations.starts_nothing(LIMITS)


@pytest.mark.parametrize(("argument", "starts"), [("broker", True), ("broker_process", True), ("broken", False)])
def test_a_broker_from_a_fixture_counts(tmp_path, argument, starts):
    file = tmp_path / "test_it.py"
    file.write_text(f"def test_it(\n    tmp_path, {argument}\n): ...")
    assert durations.starts_nothing(file) is not starts


def test_what_took_long_is_not_fast():
    durations.keep({name(GATE): durations.LONGEST_FAST + 1.0})
    assert durations.fast([GATE, LIMITS]) == [LIMITS]


def test_what_is_shipped_are_files_of_tests():
    shipped = json.loads((ROOT / "test/durations.json").read_text())
    assert [path for path in shipped if not (ROOT / path).is_file()] == []


def test_what_is_fast_fits_into_the_budget_on_two_cores(monkeypatch):
    monkeypatch.setattr(durations, "BUDGET", 2.0)
    durations.keep({name(GATE): 3.5, name(LIMITS): 0.2})
    # 0.2 s, and one that was never measured; the third would be too much
    assert durations.fast([GATE, LIMITS, STATES]) == [LIMITS, STATES]


def test_the_table_tells_parts_and_the_files_that_took_longest():
    lines = durations.table({"a": 1.0, "b": 20.25}, {"lint, unit tests, page": 61.2, "launch tests": 0.0}).splitlines()
    assert lines == ["lint, unit tests, page: 61 s", "   20.2 s  b", "    1.0 s  a"]
