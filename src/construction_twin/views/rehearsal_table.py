"""The report of a rehearsal for the terminal: a table of the axes, and a line for everything else that is known."""

from __future__ import annotations

import math

from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

from construction_twin.review.rehearsal_report import PASSED, AxisLoad, RehearsalReport

#: Behind a number that is an estimate.
ESTIMATE = "~"


def worst_axis(report: RehearsalReport) -> AxisLoad | None:
    """Return the axis that uses the largest fraction of what its drive gives; None: unknown of all."""
    known = [axis for axis in report.axes if axis.limit]
    return max(known, key=lambda axis: axis.usage, default=None)


def headline(report: RehearsalReport) -> str:
    """Return one line: how it ended, and the largest torque."""
    worst = worst_axis(report)
    largest = f", largest torque {worst.usage:.0%} ({worst.joint})" if worst is not None else ""
    return f"rehearsal of plan {report.plan_id}: {report.state}{largest}"


def rehearsal_lines(report: RehearsalReport) -> list[str]:
    """Return what stands below the table of the axes, one line each."""
    lines = [f"reason: {reason}" for reason in report.reasons]
    load, braking = report.payload, report.braking
    if report.axes:
        rated = f" of {load.rated_mass:.1f} kg" if load.rated_mass else ""
        inertia = f" of {load.rated_inertia:.1f}" if load.rated_inertia else ""
        mark = ESTIMATE if load.estimated else ""
        lines.append(
            f"payload: {load.mass:.1f}{mark} kg{rated}, inertia {load.inertia:.2f}{mark}{inertia} kg m^2, "
            f"centre {load.across * 1e3:.0f} mm across and {load.along * 1e3:.0f} mm along the last axis"
        )
        if braking.seconds:
            lines.append(
                f"braking at {braking.time:.2f} s: {braking.seconds:.2f} s, flange {braking.distance * 1e3:.0f} mm, "
                f"most of {braking.joint}, {braking.usage:.0%} of an axis' torque"
            )
        if math.isfinite(report.tracking) and math.isfinite(report.energy):
            lines.append(
                f"off its way by at most {report.tracking:.1e} ({report.tracking_joint}; rad, of a linear axis m); "
                f"the drives put in {report.energy / 1e3:.2f} kJ"
            )
        if report.grip.name:
            lines.append(
                f"grip: {report.grip.cups} cups on {report.grip.name}, at most {report.grip.usage:.0%} of what they hold, "
                f"at {report.grip.time:.2f} s"
            )
    lines += [
        f"contact: {each.first} and {each.second} at {each.time:.2f} s, {each.force:.0f} N, for {each.seconds:.2f} s"
        for each in report.contacts
    ]
    for each in report.objects:
        since = "stands" if math.isnan(each.released) else f"let go at {each.released:.2f} s"
        rest = "lies still" if each.resting else "still moves"
        lines.append(
            f"object {each.name}: {since}, moved {each.moved * 1e3:.1f} mm, turned {math.degrees(each.turned):.2f} deg, "
            f"fell {each.fell * 1e3:.1f} mm, {rest}"
        )
    lines += [f"remark: {remark}" for remark in report.remarks]
    took = f"{report.duration:.2f} s of a plan in {report.took:.2f} s" if report.axes else f"{report.took:.2f} s"
    lines.append(f"{report.engine or 'no engine'}, {took}; hash {report.hash[:12]}")
    return lines


def rehearsal_table(report: RehearsalReport) -> Group:
    """Return all of it, for a rich console."""
    style = "bold green" if report.state == PASSED else "bold red"
    parts: list[Text | Table] = [Text(headline(report), style=style)]
    if report.axes:
        table = Table(box=box.SIMPLE, caption=f"{ESTIMATE} an estimate", caption_justify="left")
        for name in ("axis", "peak", Text("at [s]"), "RMS", "limit", "used", "gravity"):
            table.add_column(name, justify="left" if name == "axis" else "right")
        for axis in report.axes:
            mark = ESTIMATE if axis.estimated else ""
            table.add_row(
                axis.joint,
                f"{axis.peak:.0f}",
                f"{axis.time:.2f}",
                f"{axis.rms:.0f}",
                f"{axis.limit:.0f}{mark}" if axis.limit else "not known",
                Text(f"{axis.usage:.0%}" if axis.limit else "", style="bold red" if axis.usage > 1.0 else ""),
                f"{axis.gravity:.0%}",
            )
        parts.append(table)
    parts += [
        Text(line, style="red" if line.startswith(("reason", "contact")) else "") for line in rehearsal_lines(report)
    ]
    return Group(*parts)
