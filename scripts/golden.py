"""Compares what the simulated chain sends, byte for byte, with what it sent at a reference commit: `python scripts/golden.py`.

Each test of test/unit/chain is a seeded run. While it runs, every reply that reaches the controller and every state that reaches
the bridge is written to results/golden/<commit>/<test>/<n>.txt, one line each, for the working tree and for the reference, both by
this machine. Runs that one side alone has are named; a difference is shown with its first line. Exit code 1: something differs.

    python scripts/golden.py                                   # against 45a2b7e5, once recorded kept until the folder is removed
    python scripts/golden.py --against COMMIT -k full_speed    # against another commit; other words are pytest's
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from itertools import count, zip_longest
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "results" / "golden"
REFERENCE = "45a2b7e5"
TREE = "tree"


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Record each chain that is made while a test runs into a file of its own (loaded by ``pytest -p golden``)."""
    from simulation import SimulatedChain

    folder = Path(os.environ["GOLDEN"], re.sub(r"[^\w.\[\]-]+", "_", item.nodeid.partition("chain/")[2]))
    originals = SimulatedChain.__init__, SimulatedChain._take_reply, SimulatedChain._receive
    number, traces = count(), []

    def begin(chain, *args, **keywords):
        folder.mkdir(parents=True, exist_ok=True)
        chain.golden = (folder / f"{next(number)}.txt").open("w")
        traces.append(chain.golden)
        originals[0](chain, *args, **keywords)

    def reply(chain, data):
        chain.golden.write(f"{chain.now} reply {data!r}\n")
        originals[1](chain, data)

    def state(chain, payload, properties):
        chain.golden.write(f"{chain.now} state {payload!r} {properties}\n")
        originals[2](chain, payload, properties)

    SimulatedChain.__init__, SimulatedChain._take_reply, SimulatedChain._receive = begin, reply, state
    try:
        return (yield)
    finally:
        SimulatedChain.__init__, SimulatedChain._take_reply, SimulatedChain._receive = originals
        for trace in traces:
            trace.close()


def record(tree: Path, name: str, words: list[str]) -> None:
    """Run the chain's tests of a tree and write their traces below ``results/golden/<name>``."""
    folder = RESULTS / name
    # the working tree is what the shell's environment finds; a reference stands before it, with messages of its own
    first = [ROOT / "scripts", *([] if tree == ROOT else [tree / "src"])]
    path = os.pathsep.join([*map(str, first), os.environ.get("PYTHONPATH", "")])
    environment = os.environ | {"GOLDEN": str(folder), "PYTHONPATH": path}
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "golden",
        "-p",
        "no:cacheprovider",
        "test/unit/chain",
        *words,
    ]
    print(f"[golden] recording {name} into {folder}", flush=True)
    code = subprocess.run(command, cwd=tree, env=environment).returncode
    if code:
        sys.exit(f"golden: the tests of {name} ended with {code}; mend them first")


def differences(old: Path, new: Path) -> Iterator[str]:
    """Yield a sentence for each run that differs, or that one side alone has."""
    runs = [{str(path.relative_to(folder)) for path in folder.rglob("*.txt")} for folder in (old, new)]
    for run in sorted(runs[0] - runs[1]):
        yield f"only in {old.name}: {run}"
    for run in sorted(runs[1] - runs[0]):
        yield f"only in {new.name}: {run}"
    for run in sorted(runs[0] & runs[1]):
        with (old / run).open() as before, (new / run).open() as after:
            for number, (one, other) in enumerate(zip_longest(before, after, fillvalue="(ended)\n"), 1):
                if one != other:
                    yield f"{run}, line {number}:\n  {old.name}: {one}  {new.name}: {other}"
                    break


def main() -> int:
    """Record what is missing, compare, and return 1 where something differs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--against", metavar="COMMIT", default=REFERENCE, help="what the working tree is compared with [%(default)s]"
    )
    arguments, words = parser.parse_known_args()
    if words or not (RESULTS / arguments.against).is_dir():
        sys.path.insert(0, str(ROOT / "benchmarks"))
        from turns import put

        with tempfile.TemporaryDirectory() as folder:
            put(arguments.against, Path(folder), own=True)
            record(Path(folder), arguments.against, words)
    record(ROOT, TREE, words)
    found = list(differences(RESULTS / arguments.against, RESULTS / TREE))
    print("\n".join(found) or f"golden: every run is equal to {arguments.against}")
    return 1 if any(not line.startswith("only") for line in found) else 0


if __name__ == "__main__":
    sys.exit(main())
