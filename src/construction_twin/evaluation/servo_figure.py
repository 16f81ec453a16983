"""Draws how well the identified servos explain a recording. Matplotlib takes a second to import."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from construction_twin.core.units import NANOSECONDS
from construction_twin.evaluation.figures import COLOURS, INK
from construction_twin.servo.identification import Drive, IdentifiedJoint, response

#: Drawn of a recording at most [cycles]: around where a joint is fastest.
SHOWN = 750


def fit_figure(drives: Sequence[Drive], joint: int, found: IdentifiedJoint, cycle_ns: int, unit: str) -> Figure:
    """Return one joint where it is fastest: how far it trails its target, measured and by the model, and what is left.

    Args:
        joint: Its column in `drives`.
        unit: ``rad`` or ``m``.
    """
    period = cycle_ns / NANOSECONDS
    drive, middle = max(
        ((drive, _fastest(drive, joint)) for drive in drives),
        key=lambda pair: abs(_step(pair[0], joint)[pair[1]]),
    )
    targets, measured = drive.targets[:, joint], drive.measured[:, joint]
    model = response(found.servo, targets, period)
    shown = slice(max(0, middle - SHOWN // 2), middle + SHOWN // 2)
    seconds = np.arange(len(targets))[shown] * period
    figure = Figure(figsize=(8.0, 5.0), layout="constrained")
    FigureCanvasAgg(figure)
    above, below = figure.subplots(2, 1, sharex=True)
    above.plot(seconds, (targets - measured)[shown], color=COLOURS[0], linewidth=2.6, alpha=0.5, label="measured")
    above.plot(seconds, (targets - model)[shown], color=INK, linewidth=1.0, label="model")
    above.set(title=f"{found.name}: target minus position", ylabel=f"[{unit}]")
    above.legend()
    below.plot(seconds, (measured - model)[shown], color=COLOURS[1], linewidth=0.9)
    below.set(title="measured minus model", xlabel="time [s]", ylabel=f"[{unit}]")
    return figure


def _step(drive: Drive, joint: int) -> np.ndarray:
    return np.diff(drive.targets[:, joint], prepend=drive.targets[0, joint]) * drive.counts


def _fastest(drive: Drive, joint: int) -> int:
    return int(np.argmax(np.abs(_step(drive, joint))))
