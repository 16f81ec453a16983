"""scripts/run_tests.py: nothing that was asked for is green without having run."""

from __future__ import annotations

import pytest
import run_tests


def test_each_row_names_what_is_there():
    words = {word for row in run_tests.TOUCHES.values() for word in row.split()}
    launches = {test.stem for test in (run_tests.ROOT / "test/integration").glob("*.test")}
    assert words <= launches | {"lint", "unit", "repository", "realtime", "browser"}
    assert [path for path in run_tests.TOUCHES if not list(run_tests.ROOT.glob(f"{path}*"))] == []


@pytest.mark.parametrize(
    "text, is_fine",
    [("def test_it(): pass", True), ("", False), ("import pytest; pytest.skip(allow_module_level=True)", False)],
)
def test_a_part_that_tests_nothing_is_a_failure(tmp_path, monkeypatch, capsys, text, is_fine):
    monkeypatch.setattr(run_tests, "RESULTS", tmp_path)
    (file := tmp_path / "test_it.py").write_text(text)
    passed, failures = run_tests.Run("part", [file]).end()
    assert (passed == 1, not failures) == (is_fine, is_fine)


def test_a_name_of_nothing_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(run_tests, "RESULTS", tmp_path)
    with pytest.raises(SystemExit, match="no such tests: brinup"):
        run_tests.main(["lint", "brinup"])
