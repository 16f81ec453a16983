"""The picture of what was built."""

from __future__ import annotations

from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.work.build_report import draw


def test_what_stands_and_what_lies_in_stock_is_drawn(tmp_path):
    board = SceneObject("board/0", "box", (1.0, 0.2, 0.02), (2.0, 0.0, 0.5))
    scene = Scene(
        (
            board,
            SceneObject("brick/0", "box", (0.24, 0.115, 0.071), (2.0, 1.0, 0.5)),
            SceneObject("floor", "box", (9.0, 9.0, 1.0)),
        )
    )
    draw(scene, {"board": "Board"}, "one of two").savefig(tmp_path / "built.png")
    assert (tmp_path / "built.png").stat().st_size > 5000
