"""What each file of tests took when it was run last: nothing of it is kept by hand.

A run keeps it in `.ws/test_durations.json`. What was never run here counts as in `test/durations.json`, which
`python scripts/durations.py` writes after a whole run: a fresh checkout, as CI has one, begins with the long ones, too.
"""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree

import touched

ROOT = Path(__file__).resolve().parent.parent
KEPT = ROOT / ".ws" / "test_durations.json"
SHIPPED = ROOT / "test" / "durations.json"
#: What a file counts that is in neither [s]; shorter ones are not shipped.
UNMEASURED = 1.0
#: Of the fast tests, on each of two cores [s]; what remains of three minutes is for the set-up and for collecting them.
BUDGET, CORES = 120.0, 2
#: A file that takes longer is not fast [s].
LONGEST_FAST = 10.0
#: What a unit test starts other programs with: modules that it leads to.
PROGRAMS = ("subprocess", "multiprocessing")
#: Fixtures of test/unit/conftest.py that start one.
STARTING = re.compile(r"\bdef test_\w+\([^)]*\bbroker(_process)?\b", re.DOTALL)
#: Lines of the table at the end.
SHOWN = 20


def kept() -> dict[str, float]:
    """Return what each file took when it was run last [s], by its path below the repository; else what is shipped."""
    return _read(SHIPPED) | _read(KEPT)


def _read(file: Path) -> dict[str, float]:
    try:
        found = json.loads(file.read_text())
    except (OSError, ValueError):
        return {}
    return {name: float(took) for name, took in found.items()} if isinstance(found, dict) else {}


def keep(took: Mapping[str, float]) -> None:
    """Keep what files took [s]; of those that were not run, what is known stays."""
    if not took:
        return
    KEPT.parent.mkdir(exist_ok=True)
    _write(KEPT, {name: round(seconds, 2) for name, seconds in (_read(KEPT) | dict(took)).items()})


def ship() -> None:
    """Write what is shipped: whole seconds of the files that took longer than one that is not."""
    _write(SHIPPED, {name: round(seconds) for name, seconds in kept().items() if round(seconds) > UNMEASURED})


def _write(file: Path, known: Mapping[str, float]) -> None:
    present = {name: known[name] for name in sorted(known) if (ROOT / name).is_file()}
    file.write_text(json.dumps(present, indent=1) + "\n")


def of_junit(file: Path) -> dict[str, float]:
    """Return what each file of tests took [s], of a result file of pytest's older family; empty if it cannot be read."""
    try:
        root = ElementTree.parse(file).getroot()
    except (OSError, ElementTree.ParseError):
        return {}  # `count` makes a failure of it
    took: defaultdict[str, float] = defaultdict(float)
    for case in root.iter("testcase"):
        if name := case.get("file"):
            took[name] += float(case.get("time", 0.0))
    return dict(took)


def longest_first(files: Sequence[Path]) -> list[Path]:
    """Return files in the order in which processes take them: whichever is free takes the longest that is left."""
    known = kept()
    return sorted(files, key=lambda file: (-known.get(_name(file), UNMEASURED), file))


def fast(files: Sequence[Path]) -> list[Path]:
    """Return the files that start no other program, the shortest ones that fit into the budget."""
    known = kept()
    pure = [file for file in files if starts_nothing(file)]
    left, chosen = BUDGET * CORES, []
    for file in sorted(pure, key=lambda file: known.get(_name(file), UNMEASURED)):
        took = known.get(_name(file), UNMEASURED)
        left -= took
        if took > LONGEST_FAST or left < 0:
            break
        chosen.append(file)
    return chosen


def starts_nothing(file: Path) -> bool:
    """Return whether neither a file of tests nor what it imports of test/support can start another program."""
    if STARTING.search(file.read_text()):
        return False
    waiting, seen = [file], {file}
    while waiting:
        for name in touched.imported(waiting.pop()):
            if name.split(".")[0] in PROGRAMS:
                return False
            beside = ROOT / "test" / "support" / f"{name}.py"
            if beside.is_file() and beside not in seen:
                seen.add(beside)
                waiting.append(beside)
    return True


def table(took: Mapping[str, float], parts: Mapping[str, float]) -> str:
    """Return where the time went: the parts of a run, and the files that took longest."""
    lines = [f"{name}: {seconds:.0f} s" for name, seconds in parts.items() if seconds >= 0.5]
    for name in sorted(took, key=lambda name: -took[name])[:SHOWN]:
        lines.append(f"{took[name]:7.1f} s  {name}")
    return "\n".join(lines)


def _name(file: Path) -> str:
    return file.relative_to(ROOT).as_posix()


if __name__ == "__main__":
    ship()
