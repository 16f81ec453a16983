"""Runs a benchmark for two commits in turns, so that both find the same machine.

    python benchmarks/turns.py planning 90a3d156
    python benchmarks/turns.py planning 90a3d156 HEAD --rounds 5 --output turns.json -- --runs 1

Each commit's files are put into a folder of their own, with the benchmarks of this folder: the library, the settings and the models
are the commit's, its messages too; what measures is the same. With `--own` each keeps its own benchmarks: the link's do not run
with another protocol than their own. Packages and the interpreter are those of the shell. The rounds go A, B,
B, A, A, B, ...; of every figure the median over the rounds is printed for both, and their quotient. Without a second commit it
is the working tree's own files, as far as git knows them.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "construction_twin"
#: ROS's generator of Python messages, and the packages whose messages it finds.
GENERATOR, SHARE = Path("/usr/lib/genpy"), Path("/usr/share")


def put(commit: str, folder: Path, own: bool = False) -> None:
    """Write a commit's files into a folder, with the benchmarks of this one, or its own; an empty commit is the working tree."""
    if commit:
        archive = subprocess.run(["git", "-C", ROOT, "archive", commit], check=True, capture_output=True).stdout
        subprocess.run(["tar", "-x", "-C", folder], input=archive, check=True)
    else:
        listed = subprocess.run(
            ["git", "-C", ROOT, "ls-files", "-z"], check=True, capture_output=True, text=True
        ).stdout
        for name in filter(None, listed.split("\0")):
            if (ROOT / name).is_file():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, folder / name)
    if not own:
        shutil.rmtree(folder / "benchmarks", ignore_errors=True)
        shutil.copytree(ROOT / "benchmarks", folder / "benchmarks", ignore=shutil.ignore_patterns("__pycache__"))
    make_messages(folder)


def make_messages(folder: Path) -> None:
    """Make the Python modules of a commit's messages and services, where ROS's generator is installed."""
    if not GENERATOR.is_dir():
        return
    packages = sorted(path for path in (folder, *SHARE.iterdir()) if (path / "msg").is_dir())
    found = [f"-I{PACKAGE if path == folder else path.name}:{path / 'msg'}" for path in packages]
    for kind in ("msg", "srv"):
        made = folder / "src" / PACKAGE / kind
        files = sorted(map(str, (folder / kind).glob(f"*.{kind}")))
        for options in (["-p", PACKAGE, "-o", str(made), *found, *files], ["--initpy", "-p", PACKAGE, "-o", str(made)]):
            subprocess.run([sys.executable, GENERATOR / f"gen{kind}_py.py", *options], check=True)


def run(benchmark: str, folder: Path, options: list[str]) -> dict[str, float]:
    """Run a benchmark once on the files in a folder; return its figures by their path, like ``free.review_ms.median``."""
    output = folder / "figures.json"
    path = os.pathsep.join([str(folder / "src"), *filter(None, [os.environ.get("PYTHONPATH")])])
    command = [sys.executable, str(folder / "benchmarks" / f"{benchmark}.py"), "--output", str(output), *options]
    subprocess.run(command, check=True, cwd=folder, env=os.environ | {"PYTHONPATH": path}, stdout=subprocess.DEVNULL)
    return dict(numbers(json.loads(output.read_text())))


def numbers(values: object, path: str = "") -> Iterator[tuple[str, float]]:
    """Yield the numbers of a JSON document, each with its path."""
    if isinstance(values, dict):
        for key, value in values.items():
            yield from numbers(value, f"{path}.{key}" if path else key)
    elif isinstance(values, (int, float)) and not isinstance(values, bool):
        yield path, float(values)


def compared(first: list[dict[str, float]], second: list[dict[str, float]]) -> dict[str, dict[str, float | None]]:
    """Return the medians over the rounds of each figure that both have, and the second over the first; None: over zero."""
    rows: dict[str, dict[str, float | None]] = {}
    for name in first[0]:
        if all(name in figures for figures in (*first, *second)):
            before, after = (statistics.median(figures[name] for figures in rounds) for rounds in (first, second))
            rows[name] = {"first": before, "second": after, "ratio": after / before if before else None}
    return rows


def main() -> None:
    """Measure in turns, print, write."""
    parser = argparse.ArgumentParser(description="Runs a benchmark for two commits in turns.")
    parser.add_argument("benchmark", help="name of a program of this folder, as `planning`")
    parser.add_argument("first", help="a commit")
    parser.add_argument("second", nargs="?", default="", help="another commit [default: the working tree]")
    parser.add_argument("--rounds", type=int, default=3, help="runs of each [%(default)s]")
    parser.add_argument("--own", action="store_true", help="each commit's own benchmarks, not those of this folder")
    parser.add_argument("--output", type=Path, metavar="FILE", help="[results/bench/turns_<benchmark>.json]")
    arguments, split = sys.argv[1:], len(sys.argv) - 1
    if "--" in arguments:
        split = arguments.index("--")
    options = parser.parse_args(arguments[:split])
    if options.rounds < 1:
        parser.error("expected at least one round")
    commits = options.first, options.second
    seen: tuple[list[dict[str, float]], list[dict[str, float]]] = ([], [])
    with tempfile.TemporaryDirectory() as first, tempfile.TemporaryDirectory() as second:
        folders = Path(first), Path(second)
        for commit, folder in zip(commits, folders):
            put(commit, folder, options.own)
        for number in range(options.rounds):
            for which in (0, 1) if number % 2 == 0 else (1, 0):
                seen[which].append(run(options.benchmark, folders[which], arguments[split + 1 :]))
    rows = compared(*seen)
    for name, row in rows.items():
        ratio = "" if row["ratio"] is None else f"{row['ratio']:.3f}"
        print(f"{name:<36}{row['first']:>12.4g}{row['second']:>12.4g}{ratio:>8}")
    output = options.output or ROOT / "results" / "bench" / f"turns_{options.benchmark}.json"
    output.parent.mkdir(parents=True, exist_ok=True)
    names = {"first": options.first, "second": options.second or "working tree"}
    content = {"commits": names, "rounds": options.rounds, "figures": rows, "seen": dict(zip(names, seen))}
    output.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    print(output)


if __name__ == "__main__":
    main()
