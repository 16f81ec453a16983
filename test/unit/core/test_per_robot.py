"""Command lines of several robots."""

from __future__ import annotations

import pytest

from construction_twin.core.per_robot import AND, per_robot


@pytest.mark.parametrize(
    "words, robots",
    [
        ([], [[]]),
        (["--config", "a"], [["--config", "a"]]),
        (["--config", "a", AND, "--config", "b", AND], [["--config", "a"], ["--config", "b"], []]),
    ],
)
def test_the_options_of_each_robot_stand_between_two_marks(words, robots):
    assert per_robot(words) == robots
