"""What the terminal shows of a rehearsal."""

from __future__ import annotations

import io
import math
from dataclasses import replace

from rich.console import Console

from construction_twin.physics.report import (
    BROKEN,
    FAILED,
    PASSED,
    AxisLoad,
    Braking,
    LooseObject,
    PayloadLoad,
    RehearsalReport,
    RehearsedContact,
)
from construction_twin.views.rehearsal_table import headline, rehearsal_table

REPORT = RehearsalReport(
    plan_id="p1",
    state=PASSED,
    axes=(
        AxisLoad("a1", 1000.0, 0.5, 400.0, 0.25, 4000.0, True),
        AxisLoad("a2", 1830.0, 1.5, 900.0, 0.75, 3000.0, False),
        AxisLoad("a3", 500.0, 2.5, 100.0, 0.5, 0.0, False),
    ),
    payload=PayloadLoad(mass=42.0, estimated=True, rated_mass=120.0),
    braking=Braking(1.25, 0.5, 0.321, "a1", 0.2, 0.44),
    engine="MuJoCo 4",
)


def shown(report: RehearsalReport) -> str:
    file = io.StringIO()
    Console(file=file, width=140).print(rehearsal_table(report))
    return file.getvalue()


def row(text: str, name: str) -> list[str]:
    (line,) = [line for line in text.splitlines() if line.split()[:1] == [name]]
    return line.split()


def test_one_line_says_how_it_ended_and_which_axis_uses_most():
    assert headline(REPORT) == "rehearsal of plan p1: passed, largest torque 61% (a2)"
    assert headline(replace(REPORT, axes=REPORT.axes[2:])) == "rehearsal of plan p1: passed"


def test_each_axis_has_peak_rms_limit_fraction_and_gravity_and_an_estimate_is_marked():
    text = shown(REPORT)
    assert row(text, "a1") == ["a1", "1000", "0.50", "400", "4000~", "25%", "25%"]
    assert row(text, "a2") == ["a2", "1830", "1.50", "900", "3000", "61%", "75%"]
    assert row(text, "a3") == ["a3", "500", "2.50", "100", "not", "known", "50%"]


def test_payload_and_braking():
    text = shown(REPORT)
    assert "payload: 42.0~ kg of 120.0 kg" in text and "flange 321 mm, most of a1, 44% of an axis' torque" in text


def test_tracking_and_energy_where_they_are_known():
    text = shown(replace(REPORT, tracking=2.5e-4, tracking_joint="a3", energy=1234.0))
    assert "off its way by at most 2.5e-04 (a3; rad, of a linear axis m); the drives put in 1.23 kJ" in text
    assert "off its way" not in shown(REPORT)


def test_reasons_contacts_objects_and_remarks_of_one_that_failed():
    report = replace(
        REPORT,
        state=FAILED,
        reasons=("too heavy",),
        contacts=(RehearsedContact("tool", "wall", 1.5, (0.9, 0.2, 1.1), 30.0, 0.1),),
        objects=(
            LooseObject("beam", 2.0, 0.05, math.radians(2.0), 0.04, False),
            LooseObject("crate", math.nan, 0.1, 0.0, 0.0, True),
        ),
        remarks=("a guess",),
    )
    text = shown(report)
    for line in (
        "reason: too heavy",
        "contact: tool and wall at 1.50 s, 30 N",
        "object beam: let go at 2.00 s, moved 50.0 mm, turned 2.00 deg, fell 40.0 mm, still moves",
        "object crate: stands, moved 100.0 mm",
        "remark: a guess",
    ):
        assert line in text


def test_of_one_that_broke_off_there_is_its_reason_and_no_table():
    text = shown(RehearsalReport(plan_id="p1", state=BROKEN, reasons=("it is late",), took=60.0))
    assert "p1: broken" in text and "reason: it is late" in text and "axis" not in text
