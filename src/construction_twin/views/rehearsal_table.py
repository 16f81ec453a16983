"""The report of a rehearsal on the terminal: what it says first, then axes, load, contacts, objects, and what is an estimate."""

from __future__ import annotations

import math
from collections.abc import Set

from rich import box
from rich.console import Console
from rich.table import Table

from construction_twin.physics.report import PASSED, RehearsalReport

#: Marks a number that nobody has measured or published.
_ESTIMATE = " (estimate)"


def print_report(report: RehearsalReport, console: Console, linear: Set[str] = frozenset()) -> None:
    """Print a report; `linear`: names of prismatic joints."""
    console.print(f"{report.state}: plan {report.plan_id}, {report.duration:.2f} s, rehearsed in {report.took:.2f} s")
    for reason in report.reasons:
        console.print(f"  {reason}", soft_wrap=True)
    if report.axes:
        console.print(_axes(report, linear))
        _say_load(report, console)
    for table in (_contacts(report), _objects(report)):
        if table is not None:
            console.print(table)
    if report.state == PASSED and not report.objects:
        console.print("contacts    none that the plan does not have")
    for remark in report.remarks:
        console.print(f"note: {remark}", soft_wrap=True)
    console.print(f"{report.engine}, report {report.hash[:12]}")


def _axes(report: RehearsalReport, linear: Set[str]) -> Table:
    table = Table("axis", box=box.SIMPLE_HEAD)
    for title in ("peak", "of limit", "limit", "at [s]", "rms", "gravity"):
        table.add_column(title, justify="right")
    for axis in report.axes:
        unit = "N" if axis.joint in linear else "Nm"
        limit = f"{axis.limit:.0f} {unit}{' *' if axis.estimated else ''}" if axis.limit else "nobody says"
        usage = f"{axis.usage:.0%}" if axis.limit else "-"
        table.add_row(
            axis.joint, f"{axis.peak:.0f} {unit}", usage, limit, f"{axis.time:.2f}", f"{axis.rms:.0f} {unit}",
            f"{axis.gravity:.0%}",
        )  # fmt: skip
    if any(axis.estimated for axis in report.axes):
        table.caption = "* an estimate"
    return table


def _say_load(report: RehearsalReport, console: Console) -> None:
    load, braking = report.payload, report.braking
    rated = f"rated for {load.rated_mass:.0f} kg" if load.rated_mass else "nobody says what the arm is rated for"
    if load.mass:
        mass = f"{load.mass:.1f} kg{_ESTIMATE if load.estimated else ''}"
        place = (
            f"{load.across * 1e3:.0f} mm across, {load.along * 1e3:.0f} mm along the flange, {load.inertia:.2f} kg m^2"
        )
        console.print(f"payload     {mass}, {place}; {rated}", soft_wrap=True)
    else:
        console.print(f"payload     none; {rated}")
    if braking.joint:
        console.print(
            f"braking     worst at {braking.time:.2f} s: {braking.seconds:.2f} s, "
            f"the flange goes on {braking.distance * 1e3:.0f} mm, {braking.usage:.0%} of a torque",
            soft_wrap=True,
        )
    console.print(f"energy      {report.energy / 1e3:.2f} kJ")


def _contacts(report: RehearsalReport) -> Table | None:
    if not report.contacts:
        return None
    table = Table("contact", "with", box=box.SIMPLE_HEAD)
    for title in ("at [s]", "force [N]", "for [s]"):
        table.add_column(title, justify="right")
    for one in report.contacts:
        table.add_row(one.first, one.second, f"{one.time:.2f}", f"{one.force:.0f}", f"{one.seconds:.2f}")
    return table


def _objects(report: RehearsalReport) -> Table | None:
    if not report.objects:
        return None
    table = Table("object", box=box.SIMPLE_HEAD)
    for title in ("let go at [s]", "moved [mm]", "turned [deg]", "fell [mm]", "rests"):
        table.add_column(title, justify="right")
    for one in report.objects:
        table.add_row(
            one.name, "never held" if math.isnan(one.released) else f"{one.released:.2f}", f"{one.moved * 1e3:.0f}",
            f"{math.degrees(one.turned):.1f}", f"{one.fell * 1e3:.0f}", "yes" if one.resting else "no",
        )  # fmt: skip
    return table
