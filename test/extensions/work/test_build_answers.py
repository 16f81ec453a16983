"""What `make build` answers when the work node asks what became of an element."""

import pytest

from construction_twin.extensions.work.commands.build import answer_of

CONFIRM = {"vacuum_reached": True}
ALL = ("in_stock", "in_grip", "placed", "gone")


@pytest.mark.parametrize(
    ("inputs", "last", "answers", "answer"),
    [
        ({"vacuum_reached": True}, "carrying", ALL, "in_grip"),
        ({"vacuum_reached": True}, "releasing", ALL, "in_grip"),
        ({"vacuum_reached": False}, "releasing", ALL, "placed"),
        ({"vacuum_reached": False, "other": True}, "carrying", ALL, "gone"),
        ({"vacuum_reached": False}, "gripping", ALL, "in_stock"),
        ({}, "", ALL, "in_stock"),
        ({"vacuum_reached": True}, "", ("in_stock", "gone"), ""),
    ],
)
def test_placed_is_only_what_was_being_released_and_held_what_the_tool_confirms(inputs, last, answers, answer):
    assert answer_of(inputs, CONFIRM, last, answers) == answer
