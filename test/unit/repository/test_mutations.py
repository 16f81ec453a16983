"""The guard of the tests: which mutations count as caught, and what its list must be."""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path

import mutations
import pytest
from mutations import Mutation

ROOT = Path(__file__).resolve().parents[3]
LISTED = mutations.read(mutations.LIST)

GUARD = """\
def passes(speed):
    limit = 1.0
    return speed <= limit


def twice(value):
    return value + value
"""
TESTS = """\
from construction_twin.guard import passes, twice


def test_a_slow_one_passes():
    assert passes(0.5)


def test_a_fast_one_does_not():
    assert not passes(2.0)


def test_twice():
    assert twice(2) == 4


def test_never_passes():
    assert twice(2) == 5
"""
FAST = "unit/test_guard.py::test_a_fast_one_does_not"
CAUGHT = Mutation("speed is limited", "guard.py", "speed <= limit", "speed <= 10 * limit", FAST)
NOT_CAUGHT = {
    "its test still passes": Mutation(
        "one", "guard.py", "value + value", "2 * value", "unit/test_guard.py::test_twice"
    ),
    "the line moved (not found)": Mutation("two", "guard.py", "speed < limit", "True", FAST),
    "the line moved (found 2 times)": Mutation("three", "guard.py", "return ", "return 2 * ", FAST),
    "the broken line is no Python": Mutation("four", "guard.py", "speed <= limit", "speed <=", FAST),
    "No such file": Mutation("five", "gone.py", "speed", "limit", FAST),
    "not by an assertion: NameError": Mutation("six", "guard.py", "speed <= limit", "speed <= most", FAST),
    "not by an assertion: collection failure: E   ImportError: cannot import name 'passes'": Mutation(
        "seven", "guard.py", "def passes", "def passed", FAST
    ),
    "fails with nothing broken: assert 4 == 5": Mutation(
        "eight", "guard.py", "value + value", "value", "unit/test_guard.py::test_never_passes"
    ),
    "fails with nothing broken: ERROR: not found": Mutation(
        "nine", "guard.py", "value + value", "value", "unit/test_guard.py::test_that_is_not_there"
    ),
    "more than 10 s": Mutation("ten", "guard.py", "limit = 1.0", "import time; time.sleep(60)", FAST),
}


@pytest.fixture(scope="module")
def repository(tmp_path_factory):
    folder = tmp_path_factory.mktemp("repository")
    (folder / "src/construction_twin").mkdir(parents=True)
    (folder / "src/construction_twin/__init__.py").touch()
    (folder / "src/construction_twin/guard.py").write_text(GUARD)
    (folder / "test/unit").mkdir(parents=True)
    (folder / "test/unit/test_guard.py").write_text(TESTS)
    (folder / "pyproject.toml").write_text("[tool.pytest.ini_options]\n")
    return folder


@pytest.fixture(scope="module")
def judged(repository):
    """Exit code and lines of a run over mutations of every kind."""
    lines: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("builtins.print", lambda *words, **_: lines.extend(" ".join(words).splitlines()))
        code = mutations.run([CAUGHT, *NOT_CAUGHT.values()], repository, 2, 10.0)
    return code, lines


def test_a_test_that_fails_by_an_assertion_has_caught_it(judged):
    code, lines = judged
    assert code == 1
    assert any(line.startswith("caught") and line.endswith(f"guard.py: {CAUGHT.behaviour}") for line in lines)
    assert lines[-1] == f"1 caught, {len(NOT_CAUGHT)} not caught"


@pytest.mark.parametrize("why", NOT_CAUGHT)
def test_whatever_else_happens_is_not_caught_and_says_why(judged, why):
    mutation = NOT_CAUGHT[why]
    _, lines = judged
    place = next(number for number, line in enumerate(lines) if line.endswith(f": {mutation.behaviour}"))
    assert (
        lines[place].startswith("NOT CAUGHT") and why in lines[place + 1] and lines[place + 2].strip() == mutation.test
    )


def test_the_checkout_stays_as_it_is(judged, repository):
    assert (repository / "src/construction_twin/guard.py").read_text() == GUARD
    assert sorted(path.name for path in repository.iterdir()) == ["pyproject.toml", "src", "test"]


def test_where_all_are_caught_the_exit_code_is_0(repository, capsys):
    assert mutations.run([CAUGHT, CAUGHT], repository, 1) == 0
    assert capsys.readouterr().out.endswith("2 caught, 0 not caught\n")


def test_no_mutation_at_all_is_a_failure(repository):
    assert mutations.run([], repository, 1) == 1


@pytest.mark.parametrize("entry", ['behaviour = "x"', 'behaviour = "x"\nfile = 1\nold = ""\nnew = ""\ntest = ""'])
def test_a_list_that_makes_no_sense_is_refused(entry, tmp_path):
    (tmp_path / "list.toml").write_text(f"[[mutation]]\n{entry}\n")
    with pytest.raises(ValueError, match="mutation 1 of .*: expected texts for behaviour, file, new, old, test"):
        mutations.read(tmp_path / "list.toml")


# -- the list itself


def test_every_listed_line_stands_where_the_list_says():
    moved = []
    for mutation in LISTED:
        try:
            mutation.break_in((mutations.ROOT / "src/construction_twin" / mutation.file).read_text())
        except (OSError, ValueError) as error:
            moved.append(f"{mutation.file}: {mutation.behaviour}: {error}")
    assert moved == []


def test_every_listed_test_is_there():
    missing = [mutation.test for mutation in LISTED if not is_there(mutation.test)]
    assert missing == []


def test_no_mutation_is_lost():
    folders = Counter(mutation.file.partition("/")[0] for mutation in LISTED)
    assert len(LISTED) >= 60 and len({mutation.behaviour for mutation in LISTED}) == len(LISTED)
    # where a mistake moves an arm, or lets somebody move it
    for folder in ("gateway", "monitor", "link", "execution", "review", "mqtt", "rsi", "planning", "scene", "work"):
        assert folders[folder] >= 5, folder


def is_there(test: str) -> bool:
    file, *names = test.split("::")
    if not (ROOT / "test" / file).exists():
        return False
    body = ast.parse((ROOT / "test" / file).read_text()).body
    for name in names:
        found = [node for node in body if getattr(node, "name", "") == name]
        if not found:
            return False
        body = found[0].body
    return True
