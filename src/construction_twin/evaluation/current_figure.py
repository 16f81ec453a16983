"""Draws motor currents beside those of a reference run. Matplotlib takes a second to import."""

from __future__ import annotations

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from construction_twin.core.units import CYCLE
from construction_twin.evaluation.currents import GAP, CurrentComparison
from construction_twin.evaluation.figures import COLOURS, DPI, INK


def current_figure(comparison: CurrentComparison) -> Figure:
    """Return per axis its currents in both runs over the time of the plan, and their difference with its largest value marked.

    Where nothing was compared the lines have a gap.
    """
    count = len(comparison.axes)
    figure = Figure(figsize=(11.0, 1.0 + 1.7 * count), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(count, 2, sharex=True, squeeze=False)
    times = comparison.times
    # not a number draws nothing: a line must not bridge what was left out
    gaps = np.flatnonzero(np.diff(times) > max(GAP, 2 * CYCLE)) + 1
    shown = np.insert(times, gaps, np.nan)
    for row, (axis, (both, difference)) in enumerate(zip(comparison.axes, panels)):
        reference, measured = (
            np.insert(values[:, row], gaps, np.nan)
            for values in (comparison.reference_values, comparison.measured_values)
        )
        both.plot(shown, reference, color=COLOURS[0], lw=3.0, alpha=0.4, label="reference")
        both.plot(shown, measured, color=INK, lw=0.9, label="here")
        difference.plot(shown, measured - reference, color=COLOURS[1], lw=0.9)
        both.set(ylabel=f"{axis.joint} [%]")
        if axis.largest is None:
            both.text(0.5, 0.5, "not told", transform=both.transAxes, ha="center", va="center", color="#888888")
        else:
            difference.plot([axis.time], [axis.largest], "o", color=INK, ms=4)
            difference.set_title(
                f"largest {axis.largest:+.2f} after {axis.time:.2f} s, rms {axis.rms:.2f}", fontsize=8, loc="right"
            )
        for panel in (both, difference):
            panel.grid(color="#dddddd", lw=0.6)
            panel.set_axisbelow(True)
            panel.spines[["top", "right"]].set_visible(False)
            panel.tick_params(labelsize=8)
            panel.set_xlim(0.0, comparison.plan.trajectory.duration)
            panel.margins(y=0.15)
    panels[0, 0].legend(frameon=False, fontsize=8, loc="upper left", ncols=2)
    panels[0, 0].set_title("motor currents", loc="left", fontsize=9)
    panels[0, 1].set_title("difference", loc="left", fontsize=9)
    for panel in panels[-1]:
        panel.set(xlabel="time of the plan [s]")
    return figure
