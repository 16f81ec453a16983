"""What commands say of files that cannot be used: which one, and what to do; no number of the system's."""

from __future__ import annotations

import errno
import os

import pytest

from construction_twin.core.errors import ConfigurationError, FileError, command_message, system_message


def failing(number: int, *names: str) -> OSError:
    return OSError(number, os.strerror(number), *names[:1], *((None, names[1]) if len(names) > 1 else ()))


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.ENOENT, "a.csv is not there; check the name"),
        (errno.ENOTDIR, "a.csv is not there; check the name"),
        (errno.EISDIR, "a.csv is a folder; name a file"),
        (errno.EACCES, "a.csv may not be used by this user"),
        (errno.EROFS, "a.csv may not be used by this user"),
        (errno.ENOSPC, "there is no space left for a.csv"),
    ],
)
def test_each_problem_has_its_sentence_and_the_file_s_name(number, words):
    error = FileError("a.csv", failing(number, "a.csv"))
    assert words in str(error) and error.path == "a.csv"
    assert command_message(failing(number, "a.csv")) == str(error) and "Errno" not in str(error)


def test_another_problem_is_said_as_the_system_says_it():
    assert command_message(failing(errno.EIO, "a.csv")) == f"a.csv: {os.strerror(errno.EIO)}"
    assert system_message(failing(errno.EIO, "a.csv")) == os.strerror(errno.EIO)
    # what has no number is said in its own words
    assert system_message(OSError("broken")) == "broken"


def test_of_two_files_both_are_named():
    assert "a.csv -> b.csv" in command_message(failing(errno.ENOENT, "a.csv", "b.csv"))


def test_any_other_error_is_said_as_it_is():
    assert command_message(ConfigurationError("a", 1, "b")) == str(ConfigurationError("a", 1, "b"))


def test_a_file_that_is_no_text_says_where(tmp_path):
    (tmp_path / "a.csv").write_bytes(b"12\xff")
    with pytest.raises(UnicodeDecodeError) as caught:
        (tmp_path / "a.csv").read_text(encoding="utf-8")
    assert "a.csv is no text in UTF-8 from byte 2 on" in str(FileError("a.csv", caught.value))


def test_the_content_of_a_wrong_file_is_cut_off_before_what_is_said_of_it():
    said = str(ConfigurationError("scene.yaml", "x" * 5000, "a mapping"))
    assert said.startswith("scene.yaml: found 'xxx") and said.endswith("xxx..., expected a mapping")
    assert len(said) < 400
