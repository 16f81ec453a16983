"""Writes a recording's report: `report.html`, `summary.json`, `table1.csv` and the figures.

Importing matplotlib takes a second.
"""

from __future__ import annotations

import dataclasses
import importlib.metadata
import json
import os
import platform
from dataclasses import dataclass
from pathlib import Path

from construction_twin.evaluation import figures
from construction_twin.evaluation.page import page
from construction_twin.evaluation.recording import Recording
from construction_twin.evaluation.summary import evaluate, summarise
from construction_twin.evaluation.tables import table_csv
from construction_twin.robot.description import RobotModel

#: The page that holds everything.
PAGE = "report.html"


@dataclass(frozen=True)
class Report:
    """What `write_report` wrote.

    Attributes:
        summary: The content of `summary.json`.
    """

    summary: dict
    files: tuple[Path, ...]


def write_report(recording: Recording, robot: RobotModel | None, directory: str | Path, twin: str = "") -> Report:
    """Evaluate a recording and write everything into `directory`, which is made if it does not exist.

    Args:
        twin: What simulated the twin, as the launch argument `twin` says it; empty: nobody knows.
        robot: For the tool path and the joints' units; without it, or when it has other joints than the recording, `figure8.png` is
            not written, and every joint is taken as revolute.

    Raises:
        ConstructionTwinError: If the recording cannot be evaluated; nothing is written then.
        OSError: If a file cannot be written.
    """
    if robot is not None and robot.joint_names != recording.joint_names:
        robot = None
    if robot is not None:
        linear = tuple(joint for joint, slides in zip(robot.joint_names, robot.linear) if slides)
        recording = dataclasses.replace(recording, linear=linear)
    evaluation = evaluate(recording)
    summary = {**summarise(evaluation), "twin": twin or None, "environment": environment(twin)}
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    drawings = {"figure9.png": figures.joint_figure(evaluation), "timing.png": figures.timing_figure(evaluation)}
    if robot is not None:
        drawings["figure8.png"] = figures.tool_path_figure(evaluation, robot)
    for name, drawing in drawings.items():
        drawing.savefig(directory / name)
    images = {name: (directory / name).read_bytes() for name in drawings}
    (directory / PAGE).write_text(page(summary, recording, images), encoding="utf-8")
    (directory / "table1.csv").write_text(table_csv(summary["tables"]), encoding="ascii")
    text = json.dumps(summary, indent=2, allow_nan=False) + "\n"
    (directory / "summary.json").write_text(text, encoding="utf-8")
    names = sorted([*drawings, PAGE, "summary.json", "table1.csv"])
    return Report(summary, tuple(directory / name for name in names))


def environment(twin: str = "") -> dict:
    """Return the versions of the interpreter and libraries, and the machine; with a twin in MuJoCo that of the engine, too."""
    names = ("numpy", "scipy", *(("mujoco-core",) if twin == "mujoco" else ()))
    packages = {name: importlib.metadata.version(name) for name in names}
    return {"python": platform.python_version(), "system": platform.platform(), "cpus": os.cpu_count(), **packages}
