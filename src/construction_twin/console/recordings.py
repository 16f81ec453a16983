"""The recorded runs and their reports, as a list for the page. Files are found by looking, never by a path that a request names."""

from __future__ import annotations

import json
from pathlib import Path

#: Files of a run that may be looked at.
SHOWN = (".html", ".png", ".csv", ".json")
#: What the page can play of a run, as `evaluation/replay.py` makes it.
REPLAY = "replay.json"
#: Longest list.
MOST = 200


def recordings(folder: Path) -> dict[str, Path]:
    """Return the files of the runs below a folder of results, by their relative names.

    Args:
        folder: Each run is a folder in it with a ``report.html``; links out of the folder are left out, and so is a run's second
            name, as the link ``latest`` is one.
    """
    found: dict[str, Path] = {}
    root = folder.resolve()
    if not root.is_dir():
        return found
    reports = sorted(root.glob("*/report.html"), key=lambda path: path.stat().st_mtime, reverse=True)
    reports = [report for report in reports if not _is_second_name(report.parent, root)]
    for report in reports[:MOST]:
        for path in sorted(report.parent.iterdir()):
            if path.suffix in SHOWN and path.is_file() and path.resolve().is_relative_to(root):
                found[path.relative_to(root).as_posix()] = path
    return found


def _is_second_name(run: Path, root: Path) -> bool:
    """Return whether a folder of results is a link to another one beside it."""
    return run.is_symlink() and run.resolve().parent == root


def listing(folder: Path) -> bytes:
    """Return the list of runs as JSON, the newest first: name, time of the report [s since 1970], paths of report and replay.

    `replay` is empty for a run whose report was written without one.
    """
    found = recordings(folder)
    runs = []
    for name, path in found.items():
        if path.name != "report.html":
            continue
        replay = name.removesuffix(path.name) + REPLAY
        stamp = path.stat().st_mtime
        runs.append(
            {"name": path.parent.name, "stamp": stamp, "report": name, "replay": replay if replay in found else ""}
        )
    return json.dumps({"runs": runs}).encode()
