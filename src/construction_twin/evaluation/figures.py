"""Draws the paper's figures 8 and 9 for this run, and one of the timing. Matplotlib takes a second to import.

Only figure objects with the Agg canvas, no pyplot: nothing global, no display needed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from construction_twin.core.units import NANOSECONDS
from construction_twin.evaluation.alignment import round_trips
from construction_twin.evaluation.recording import Stream
from construction_twin.evaluation.summary import Evaluation, link_span, reply_counts
from construction_twin.evaluation.tables import axis_name, percentiles
from construction_twin.kinematics.chain import Chain
from construction_twin.robot.description import RobotModel

DPI = 150
PINK = "#ff3fa4"
COLOURS = ("#1f5fa8", "#d9541e", "#2f8f4e", "#8d4bb0", "#c79a00", "#4aa3c7", "#7a5c48", "#555555")
INK = "#333333"
#: Most points drawn of a path; more are not distinguishable.
PATH_POINTS = 1500


def joint_figure(evaluation: Evaluation) -> Figure:
    """Return all joints of both robots over the evaluated time: twin solid, physical dashed (the paper's Figure 9).

    Prismatic joints have a panel of their own, in m.
    """
    recording = evaluation.recording
    slides = [joint in recording.linear for joint in recording.joint_names]
    units = {False: "joint angle [rad]", True: "joint position [m]"}
    kinds = [kind for kind in units if kind in slides]
    figure, panels = _figure(9.0, 5.4 if len(kinds) == 1 else 8.1, len(kinds))
    for kind, axes in zip(kinds, panels):
        _draw_joints(axes, evaluation, [number for number, slide in enumerate(slides) if slide is kind])
        axes.set(ylabel=units[kind])
    panels[0].set(title="Joint angles of twin and physical arm")
    panels[-1].set(xlabel="time [s]")
    return figure


def _draw_joints(axes, evaluation: Evaluation, numbers: Sequence[int]) -> None:
    recording, window = evaluation.recording, evaluation.window
    for name, style, width, shade in (("twin", "-", 1.4, 1.0), ("physical", "--", 3.4, 0.45)):
        stream = getattr(recording, name)
        inside = window.contains(stream.stamps)
        seconds = (stream.stamps[inside] - window.start) / NANOSECONDS
        for number in numbers:
            joint = recording.joint_names[number]
            label = f"{axis_name(joint) or joint} {name}"
            values = stream.positions[inside, number]
            colour = COLOURS[number % len(COLOURS)]
            order = 2 if name == "twin" else 1
            axes.plot(seconds, values, style, color=colour, lw=width, alpha=shade, label=label, zorder=order)
    axes.margins(x=0.01)
    axes.legend(ncols=2, loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, fontsize=8)


def tool_path_figure(evaluation: Evaluation, robot: RobotModel) -> Figure:
    """Return the tool's path in 3D with the arm at its start and end pose (the paper's Figure 8)."""
    chain = Chain(robot)
    twin = evaluation.recording.twin
    poses = twin.positions[evaluation.window.contains(twin.stamps)]
    poses = poses[:: max(1, len(poses) // PATH_POINTS)]
    path = np.array([chain.forward(q).position for q in poses])
    arms = {
        "arm at the start": (chain.skeleton(poses[0]), "#9aa3ab"),
        "arm at the end": (chain.skeleton(poses[-1]), INK),
    }
    figure = Figure(figsize=(7.0, 6.4), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(projection="3d", computed_zorder=False)
    for label, (points, colour) in arms.items():
        axes.plot(*points.T, "-", color=colour, lw=7, alpha=0.55, solid_capstyle="round", zorder=2)
        axes.plot(*points.T, "o", color=colour, ms=6, mec="white", mew=0.8, label=label, zorder=3)
    axes.plot(*path.T, "-", color=PINK, lw=2.6, label="tool path", zorder=4)
    axes.plot(*path[[0, -1]].T, "o", color=PINK, ms=5, mec="white", zorder=5)
    _frame_3d(axes, np.vstack([path, *(points for points, _ in arms.values())]))
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", title=f"Tool path of the task, in {robot.base_link}")
    axes.legend(loc="upper left", frameon=False, fontsize=8)
    return figure


def timing_figure(evaluation: Evaluation) -> Figure:
    """Return histograms of the round trip, of the intervals between received messages and of the gateway's reply time."""
    figure, panels = _figure(9.0, 8.6, 3)
    _round_trip_panel(panels[0], evaluation)
    _interval_panel(panels[1], evaluation)
    _reply_panel(panels[2], evaluation)
    return figure


def _round_trip_panel(axes, evaluation: Evaluation) -> None:
    trips = round_trips(evaluation.recording, evaluation.window) * 1e3
    axes.set(title="Round trip: reception of a pose after the command it answers to", xlabel="[ms]", ylabel="samples")
    if not len(trips):
        return _no_data(axes, "no command stamps in the recording")
    axes.hist(trips, bins=_bins(trips), color=COLOURS[0])
    axes.set_yscale("log")
    for name, value in percentiles(trips).items():
        if value is not None:
            _mark(axes, value, f"{name.replace('_', '.')} {value:.2f}")
    return None


def _interval_panel(axes, evaluation: Evaluation) -> None:
    axes.set(title="Intervals between messages, as received by the recorder", xlabel="[ms]", ylabel="messages")
    intervals = {}
    for name in ("twin", "physical", "command"):
        stream: Stream | None = getattr(evaluation.recording, name)
        if stream is not None:
            received = stream.received[evaluation.window.contains(stream.received)]
            intervals[name] = np.diff(received) / 1e6
    everything = np.concatenate(list(intervals.values()))
    if not len(everything):
        return _no_data(axes, "fewer than two messages")
    bins = _bins(everything)
    for number, (name, values) in enumerate(intervals.items()):
        axes.hist(values, bins=bins, histtype="step", lw=1.6, color=COLOURS[number], label=f"{name} ({len(values)})")
    axes.set_yscale("log")
    axes.legend(frameon=False, fontsize=8)
    return None


def _reply_panel(axes, evaluation: Evaluation) -> None:
    axes.set(title="RSI reply time in the gateway", xlabel="upper bin edge [us]", ylabel="replies")
    first, last = link_span(evaluation.recording.links, evaluation.window)
    counts = reply_counts(first, last)
    if last is None or not sum(counts):
        return _no_data(axes, "no reply times in the recording")
    edges = [max(1, last.reply_bins[0] / 2), *last.reply_bins]
    if len(counts) > len(last.reply_bins):
        edges.append(edges[-1] * 2)  # overflow has no upper edge; drawn as one more bin
    axes.stairs(counts, edges, fill=True, color=COLOURS[2])
    axes.set_xscale("log")
    axes.set_yscale("log")
    filled = np.flatnonzero(counts)
    axes.set_xlim(edges[filled[0]] * 0.8, max(edges[filled[-1] + 1] * 1.25, 1250.0))
    _mark(axes, 1000.0, "1 ms")
    return None


def _figure(width: float, height: float, rows: int) -> tuple[Figure, list]:
    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(rows, squeeze=False)[:, 0]
    for axes in panels:
        axes.grid(color="#dddddd", lw=0.6)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    return figure, list(panels)


def _bins(values: np.ndarray) -> np.ndarray:
    low, high = float(values.min()), float(values.max())
    margin = max(0.1, 0.02 * (high - low))
    return np.linspace(low - margin, high + margin, 101)


def _mark(axes, value: float, text: str) -> None:
    axes.axvline(value, color=INK, lw=0.8, ls=":")
    axes.annotate(
        text, (value, 0.97), xytext=(-2, 0), textcoords="offset points", xycoords=("data", "axes fraction"), fontsize=7,
        ha="right", va="top", rotation=90, bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1},
    )  # fmt: skip


def _no_data(axes, reason: str) -> None:
    axes.text(0.5, 0.5, reason, transform=axes.transAxes, ha="center", va="center", color="#888888")
    axes.set(xticks=[], yticks=[])


def _frame_3d(axes, points: np.ndarray) -> None:
    """Show all points and the floor at equal scale."""
    points = np.vstack([points, [0.0, 0.0, 0.0]])
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.08 * (high - low).max()
    low, high = low - margin, high + margin
    low[2] = min(0.0, low[2] + margin)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low)
    axes.view_init(elev=22, azim=-58)
