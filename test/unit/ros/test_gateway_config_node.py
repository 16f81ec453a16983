"""rsi_gateway under roslaunch: the file it hands its configuration over in."""

from __future__ import annotations

from construction_twin.core.files import write_whole


def test_a_second_start_replaces_the_file_and_leaves_nothing_else(tmp_path):
    file = tmp_path / "ros" / "kr120_rsi_gateway.json"
    for text in ("first", "second"):
        write_whole(file, text)
    assert file.read_text() == "second"
    assert list(file.parent.iterdir()) == [file]
