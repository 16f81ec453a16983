"""The report of a build: what was placed in which order, who approved it, how heavy, how held, how exactly, and when."""

from __future__ import annotations

import json
import math

from construction_twin.core.reports import TaskReport
from construction_twin.core.units import NANOSECONDS
from construction_twin.extensions.work.build_report import (
    HEADS,
    Decision,
    TaskResult,
    draw,
    rows,
    summary,
    write_report,
)
from construction_twin.scene.objects import Scene, SceneObject

#: 2027-01-04 08:00 UTC [s].
EIGHT = 1_799_049_600


def result(name, at, took, plans=1, people=("Ada",), **changes):
    values = {
        "id": name, "name": name, "element": f"id-{name}", "element_name": name, "state": "done", "reason": "", "after": (),
        "deviation_mm": 0.0131, "deviation_deg": 2.8e-14, "tolerance_mm": 5.0, "tolerance_deg": 0.573, "mass_kg": 10.5,
        "grip": "up 0 mm along", "scheduled_start": "2027-01-04T08:00:00", "scheduled_duration": 30.0,
    }  # fmt: skip
    times = {"begun": (EIGHT + at) * NANOSECONDS, "settled": (EIGHT + at + took) * NANOSECONDS}
    return TaskResult(TaskReport(**{**values, **times, **changes}), 2.0, 14.0, plans, people)


OFF = result("stud", 60, 40, 2, ("Ada", "Bob"), deviation_mm=6.2, deviation_deg=0.1)
TODO = result(
    "plate", 0, 0, 0, (), state="waiting", deviation_mm=math.nan, deviation_deg=math.nan, grip="", begun=0, settled=0,
    mass_kg=math.nan, scheduled_start="", scheduled_duration=math.nan,
)  # fmt: skip
LATE = result("first", 300, 50)
ALL = (LATE, OFF, TODO)


def test_the_figures_compare_with_the_schedule(tmp_path):
    (figures, picture) = write_report(
        tmp_path, "panel", ALL, 1, Scene(()), (Decision(EIGHT, "Ada", "approved plan p"),)
    )
    document = json.loads(figures.read_text())
    assert picture.stat().st_size > 5000
    assert document["order"] == ["id-stud", "id-first"] and document["as_scheduled"] is False
    assert summary((OFF, result("second", 120, 40)), 0)["as_scheduled"] is True
    assert document["within_tolerance"] == {"passed": 1, "not_passed": 1} and document["placed_kg"] == 21.0
    first, _, plate = document["elements"]
    assert (first["order"], first["scheduled_s"], first["took_s"], first["within_tolerance"]) == (2, 30.0, 50.0, True)
    assert (plate["order"], plate["mass_kg"], plate["settled"], plate["within_tolerance"]) == (None, None, None, None)
    assert document["decisions"][0]["person"] == "Ada"


def test_the_table_says_who_approved_what_and_what_is_not_within_tolerance():
    first, stud, plate = (dict(zip(HEADS, cells, strict=True)) for cells in rows(ALL))
    assert (stud["order"], stud["approved by"], stud["tolerance"], stud["mass"]) == (
        "1",
        "Ada, Bob",
        "NOT passed",
        "10.5 kg",
    )
    assert (first["tolerance"], first["took"]) == ("passed", "50 s")
    assert {plate[head] for head in HEADS if head not in ("task", "state", "plans")} == {""}


def test_the_picture_has_what_stands_and_what_lies_in_stock():
    scene = Scene(
        (
            SceneObject("board/0", "box", (1.0, 0.2, 0.2), (2.0, 0.0, 0.5)),
            SceneObject("brick/0", "box", (0.6, 0.3, 0.3), (2.0, 1.0, 0.5)),
            SceneObject("floor", "box", (9.0, 9.0, 1.0)),
            SceneObject("tool/0", "box", (5.0, 5.0, 5.0), link="tool0"),
        )
    )
    (above,) = draw(scene, {"board": "Board"}, "one of two").axes
    assert len(above.patches) == 2 and [text.get_text() for text in above.texts] == ["Board"]
    assert math.isclose(above.get_xlim()[0], 1.4)
