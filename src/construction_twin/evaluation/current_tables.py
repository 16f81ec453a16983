"""A comparison of motor currents as text, table and CSV file, made of what `currents.json` holds: a stored one prints the same."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence

from rich import box
from rich.console import Console
from rich.table import Table


def currents_csv(summary: Mapping) -> str:
    """Return the axes of a comparison as CSV text with a header line; what is not known is empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(summary["axes"][0])
    writer.writerows(axis.values() for axis in summary["axes"])
    return text.getvalue()


def render_currents(summary: Mapping, linear: Sequence[str], console: Console) -> None:
    """Print a comparison.

    Args:
        linear: Prismatic joints: mm in place of deg.
    """
    table = Table(
        title="motor currents against the reference; KUKA: % of the amplifier's most",
        title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True,
    )  # fmt: skip
    table.add_column("joint", no_wrap=True)
    for heading in ("largest", "rms", "ref. rms", "at, s", "setpoint", "joint at", "ref.", "here"):
        table.add_column(heading, justify="right", no_wrap=True)
    for axis in summary["axes"]:
        if axis["largest"] is None:
            table.add_row(axis["joint"], *["not told"] * 3)
            continue
        place = (
            f"{1e3 * axis['position']:.1f} mm"
            if axis["joint"] in linear
            else f"{math.degrees(axis['position']):.2f} deg"
        )
        table.add_row(
            axis["joint"], f"{axis['largest']:+.2f}", f"{axis['rms']:.2f}", f"{axis['reference_rms']:.2f}",
            f"{axis['time_s']:.2f}", str(axis["setpoint"]), place, f"{axis['reference']:.2f}", f"{axis['measured']:.2f}",
        )  # fmt: skip
    console.print(table)
    for line in currents_lines(summary):
        console.print(line, soft_wrap=True, markup=False)


def currents_lines(summary: Mapping) -> list[str]:
    """Return the sentences that stand below the table."""
    plan, currents = summary["plan"], summary["currents"]
    lines = [
        f"plan {plan['id']}, hash {plan['hash'][:12]}, {plan['duration_s']:.3f} s; reference {summary['reference']}, "
        f"compared {summary['recording']}",
        f"currents: {currents['compared']} compared; left out: {currents['other_pace']} at another pace, "
        f"{currents['no_reference']} of which the reference holds none, {currents['not_as_commanded']} where the arm did "
        "not move exactly as commanded",
    ]
    told = [axis for axis in summary["axes"] if axis["largest"] is not None]
    if told:
        worst = max(told, key=lambda axis: abs(axis["largest"]))
        lines.append(
            f"largest difference: {worst['joint']}, {worst['largest']:+.3f} after {worst['time_s']:.3f} s (setpoint "
            f"{worst['setpoint']}): {worst['measured']:.3f} in place of {worst['reference']:.3f}"
        )
    return lines
