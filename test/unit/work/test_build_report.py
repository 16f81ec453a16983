"""The report of a build: what was placed in which order, who approved it, how heavy, how held, how exactly, and when."""

from __future__ import annotations

import json
import math

from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.work.build_report import Decision, TaskResult, summary, write_report

#: 2027-01-04 08:00 UTC.
EIGHT = 1_799_049_600.0


def result(name, number, **changes):
    values = {
        "name": name,
        "element": f"id-{name}",
        "state": "done",
        "planning": 2.0,
        "motion": 14.0,
        "plans": 1,
        "deviation_mm": 0.0131,
        "deviation_deg": 2.8e-14,
        "tolerance_mm": 5.0,
        "tolerance_deg": 0.573,
        "mass": 10.5,
        "grip": "up 0 mm along",
        "approved_by": ("Ada",),
        "scheduled_start": f"2027-01-04T08:0{number}:00",
        "scheduled_duration": 30.0,
        "begun": EIGHT + 60 * number,
        "settled": EIGHT + 60 * number + 40,
    }
    return TaskResult(**{**values, **changes})


OFF = result("stud", 1, deviation_mm=6.2, deviation_deg=0.1, approved_by=("Ada", "Bob"), plans=2)
TODO = result(
    "plate", 2, state="waiting", plans=0, deviation_mm=math.nan, deviation_deg=math.nan, approved_by=(), grip="",
    begun=0.0, settled=0.0, mass=math.nan, scheduled_start="", scheduled_duration=math.nan,
)  # fmt: skip
LATE = result("first", 0, begun=EIGHT + 300, settled=EIGHT + 350)
ALL = (LATE, OFF, TODO)


def test_the_figures_compare_with_the_schedule():
    document = summary(ALL, 1, (Decision(EIGHT, "Ada", "approved plan p"),))
    assert document["order"] == ["id-stud", "id-first"] and document["as_scheduled"] is False
    assert summary((OFF, result("second", 2)), 0)["as_scheduled"] is True
    assert document["within_tolerance"] == {"passed": 1, "not_passed": 1} and document["placed_kg"] == 21.0
    first, _, plate = document["elements"]
    assert (first["order"], first["scheduled_s"], first["took_s"], first["within_tolerance"]) == (2, 30.0, 50.0, True)
    assert (plate["order"], plate["mass_kg"], plate["settled"], plate["within_tolerance"]) == (None, None, None, None)
    assert document["decisions"][0]["person"] == "Ada"


def test_the_page_says_who_decided_what_and_what_was_not_as_planned(tmp_path):
    scene = Scene((SceneObject("id-first/0", "box", (1.0, 0.2, 0.02), (2.0, 0.0, 0.5)),))
    decisions = (
        Decision(EIGHT, "Ada", "approved plan p1 of first, hash abcdef"),
        Decision(EIGHT + 9, "Bob <b>", "answered in_stock for stud"),
    )
    figures, _, page = write_report(tmp_path, "panel", ALL, 0, scene, decisions)
    text = page.read_text()
    assert "2 of 3 elements were placed, not in the order of the schedule: stud, first." in text
    assert "were scheduled for 60 s and took 90 s" in text
    assert "Tolerance 5 mm and 0.57 deg: passed by 1 of 2, not by stud." in text
    for cell in (
        "Ada",
        "Bob &lt;b&gt;",
        "approved plan p1 of first, hash abcdef",
        "answered in_stock for stud",
        "10.5 kg",
    ):
        assert f"<td>{cell}</td>" in text
    assert json.loads(figures.read_text())["done"] == 2
