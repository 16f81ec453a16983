"""The pictures of what was built."""

from __future__ import annotations

import math

import numpy as np
import pytest

from construction_twin.core import extras
from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.physics import film
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.work.build_report import TaskResult, draw, in_space, write_report

BOARD = SceneObject("board/0", "box", (1.0, 0.2, 0.2), (2.0, 0.0, 0.5))
BRICK = SceneObject("brick/0", "box", (0.6, 0.3, 0.3), (2.0, 1.0, 0.5))
FLOOR = SceneObject("floor", "box", (9.0, 9.0, 1.0))
CARRIED = SceneObject("tool/0", "box", (5.0, 5.0, 5.0), link="tool0")
SCENE = Scene((BOARD, BRICK, FLOOR, CARRIED))
BUILT = TaskResult("Board", "board", "done", 1.0, 2.0, 1, 0.1, 0.01, 2.0, 0.5)


@pytest.fixture
def with_graphics():
    try:
        film.open_context().free()
    except ConstructionTwinError as error:
        pytest.skip(f"nothing draws here: {error}")


def test_in_space_what_was_built_is_green_and_what_is_in_stock_yellow(with_graphics):
    def shares(built: dict[str, str]) -> tuple[float, float]:
        pixels = in_space(SCENE, built)
        red, green, blue = np.moveaxis(pixels.astype(float), -1, 0)
        return ((green > 1.4 * red) & (green > 1.2 * blue)).mean(), ((red > 1.1 * green) & (green > 1.4 * blue)).mean()

    green, yellow = shares({"board": "Board"})
    # floor and what the arm carries are no elements
    assert green > 0.02 and yellow > 0.02 and green + yellow < 0.6
    assert shares({})[0] == 0.0
    assert shares({"board": "Board", "brick": "Brick"})[1] == 0.0


@pytest.mark.parametrize("missing", ["the group physics", "a way to draw"])
def test_without_a_picture_in_space_a_sentence_says_why_and_all_else_is_there(tmp_path, monkeypatch, missing):
    if missing == "the group physics":
        monkeypatch.setitem(extras.PACKAGES, "physics", ("no_such_package",))
        with pytest.raises(ConfigurationError):
            in_space(SCENE, {})
    else:
        monkeypatch.setattr(film, "WAYS", ("no_such_way",))
        monkeypatch.delenv("MUJOCO_GL", raising=False)
    figures, picture, page = write_report(tmp_path, "one of two", [BUILT], 0, SCENE)
    assert "there is no picture in space: " in page.read_text()
    assert ("setup/setup.sh physics" in page.read_text()) is (missing == "the group physics")
    assert figures.stat().st_size > 100 and picture.stat().st_size > 5000


def test_from_above_alone_what_stands_and_what_lies_in_stock_is_drawn(tmp_path):
    figure = draw(SCENE, {"board": "Board"}, "one of two")
    (above,) = figure.axes
    assert len(above.patches) == 2 and [text.get_text() for text in above.texts] == ["Board"]
    assert math.isclose(above.get_xlim()[0], 1.4)
