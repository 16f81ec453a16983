"""What the port does for every make: the plain layout without a file, and no file where a make has none."""

from __future__ import annotations

import frames_make
import pytest

from construction_twin.core.errors import ConfigurationError
from construction_twin.rsi import make as rsi_make

AXES = tuple(f"A{number}" for number in range(1, 7))


@pytest.mark.parametrize("make", [rsi_make.MAKE, frames_make.MAKE], ids=lambda make: make.name)
def test_an_arm_without_a_file_has_the_plain_layout_of_its_make(make):
    assert make.layout_of("", AXES) == make.plain(AXES)


def test_a_make_without_files_refuses_one():
    with pytest.raises(ConfigurationError, match="none: frames has no file for its telegrams"):
        frames_make.MAKE.form_of("<ROOT/>")
