"""Runs every test and ends with `N passed, N failed`: `python scripts/run_tests.py [unit|integration|NAME...]`.

Unit tests run under pytest, each `test/integration/*.test` under rostest with a ROS master of its own. A rostest that yields no
result counts as one failure.

What runs at 250 Hz is watched by a probe per core (benchmarks/machine.py): when the machine itself runs nobody for `HALT`, arm and
gateway rightly brake, and a test that wants a motion to be finished fails without a fault of ours. Such a run shows nothing: it is
said so and made again, `AGAIN` times at most. A failure beside which the machine ran stays a failure, and so does every failure where
the probe may not have a priority above what is tested.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "benchmarks"))

from machine import MachineProbe  # noqa: E402

RESULTS = ROOT / ".ws" / "test_results"
#: Longest that one rostest may take [s]; each test in it has a limit of its own.
TIME_LIMIT = 400
#: Longest line about a failed test, of the list at the end [characters].
LINE = 300
#: What failed, for that list, and which runs were made again.
FAILED: list[str] = []
DISTURBED: list[str] = []
#: Time for which a core ran nobody, from which on a failure shows nothing [ms], and how often the run is then made again. The
#: monitor calls a pose stale after 100 ms; 20 ms are usual on a shared machine, and the tests allow for that. More than the 50 ms
#: for which Linux stops real-time processes that took 95 % of a second: that would be a fault of ours.
HALT, AGAIN = 60.0, 3
#: How often the probe looks [ns]: for such a time seldom is often enough, and every look takes from the tests.
LOOK = 2_000_000
#: Highest SCHED_FIFO priority of the nodes; the probe stands above it.
REALTIME = 50
#: Unit tests that run gateway, mock controller or bridge as processes in real time: they need the machine for themselves.
ALONE = (
    "test_faults_",
    "test_fuzz",
    "test_bench_link",
    "test_gateway_program",
    "test_gateway_service",
    "test_impairment",
    "test_mock_udp",
)


def count(file: Path) -> tuple[int, int]:
    """Return (passed, failed) of a JUnit file and remember what failed; a missing or broken file is one failure."""
    try:
        root = ElementTree.parse(file).getroot()
    except (OSError, ElementTree.ParseError) as error:
        FAILED.append(f"{file}: {error}")
        return 0, 1
    suites = list(root.iter("testsuite"))
    for case in root.iter("testcase"):
        for verdict in (*case.findall("failure"), *case.findall("error")):
            words = (verdict.get("message") or verdict.text or "").strip().splitlines()
            FAILED.append(f"{case.get('classname')}.{case.get('name')}: {words[0] if words else 'no message'}"[:LINE])
    total = sum(int(suite.get("tests", 0)) for suite in suites)
    failed = sum(int(suite.get("failures", 0)) + int(suite.get("errors", 0)) for suite in suites)
    skipped = sum(int(suite.get("skipped", suite.get("skip", 0))) for suite in suites)
    if not total:
        FAILED.append(f"{file}: no test was run")
    return (total - failed - skipped, failed) if total else (0, 1)


def said(file: Path) -> list[str]:
    """Return what the tests of a rostest's result file printed: figures that are reported, not judged."""
    try:
        root = ElementTree.parse(file).getroot()
    except (OSError, ElementTree.ParseError):
        return []  # `count` makes a failure of it
    # rosunit escapes the marks of a CDATA section as if they were text
    texts = ((part.text or "").replace("<![CDATA[", "").replace("]]>", "") for part in root.iter("system-out"))
    return [line for text in texts for line in text.splitlines() if line.strip()]


def run_unit(probe: MachineProbe) -> tuple[int, int]:
    """Run pytest over test/unit: first in two halves beside each other, then alone what runs the 250 Hz path in real processes."""
    alone, rest = [], []
    for file in sorted((ROOT / "test" / "unit").rglob("test_*.py")):
        (alone if file.stem.startswith(ALONE) else rest).append(file)
    halves = {"even": rest[::2], "odd": rest[1::2]}
    runs = [(name, start_pytest(name, half)) for name, half in halves.items()]
    results = [end_pytest(name, run) for name, run in runs]
    for file in alone:
        results.append(undisturbed(file.name, lambda: end_pytest(file.stem, start_pytest(file.stem, [file])), probe))
    return sum(passed for passed, _ in results), sum(failed for _, failed in results)


def undisturbed(name: str, run: Callable[[], tuple[int, int]], probe: MachineProbe) -> tuple[int, int]:
    """Run a test; when it fails and the machine stood still meanwhile, run it again. Return (passed, failed) of the last run."""
    for repeats_left in range(AGAIN, -1, -1):
        before = len(FAILED)
        probe.taken()
        passed, failed = run()
        machine = probe.taken()
        if not failed or machine["longest_ms"] < HALT or not machine["above"] or not repeats_left:
            break
        DISTURBED.append(name)
        print(
            f"DISTURBED {name}: the machine ran nobody on a core for up to {machine['longest_ms']:.0f} ms "
            f"({HALT:.0f} ms spoil a run); {failed} failed, not counted; once more",
            flush=True,
        )
        for line in FAILED[before:]:
            print(f"not counted: {line}", flush=True)
        del FAILED[before:]
    return passed, failed


def start_pytest(name: str, files: list[Path]) -> subprocess.Popen:
    """Start pytest on some files; its result goes to ``unit_<name>.xml``."""
    command = [sys.executable, "-m", "pytest", "-q", "--timeout=300", f"--junitxml={RESULTS / f'unit_{name}.xml'}"]
    command += ["-p", "no:cacheprovider", *map(str, files)]
    with open(RESULTS / f"unit_{name}.log", "wb") as log:
        return subprocess.Popen(command, cwd=ROOT, stdout=log, stderr=subprocess.STDOUT)


def end_pytest(name: str, run: subprocess.Popen) -> tuple[int, int]:
    """Wait for a pytest, show its output and count its results."""
    run.wait()
    print((RESULTS / f"unit_{name}.log").read_text(errors="replace"), flush=True)
    passed, failed = count(RESULTS / f"unit_{name}.xml")
    if run.returncode and not failed:
        failed = 1
        FAILED.append(f"unit_{name}: pytest ended with exit code {run.returncode}")
    return passed, failed


def run_rostest(test: Path) -> tuple[int, int]:
    """Run one rostest and show its output when it fails."""
    results = RESULTS / test.stem
    shutil.rmtree(results, ignore_errors=True)  # of a disturbed run
    started = time.monotonic()
    # the tests' verdicts, logs and configurations do not belong among the user's
    environment = os.environ | {"ROS_HOME": str(results / "ros_home")}
    run = subprocess.Popen(
        ["rostest", f"--results-base-dir={results}", "construction_twin", test.name],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        env=environment,
    )
    try:
        output, _ = run.communicate(timeout=TIME_LIMIT)
    except subprocess.TimeoutExpired:
        run.send_signal(signal.SIGINT)  # lets it end its nodes
        output, _ = run.communicate()
    # rosunit-*.xml: the tests; rostest-*.xml: whether they could be run at all
    tests = [count(file) for file in sorted(results.rglob("rosunit-*.xml"))]
    launches = [count(file) for file in sorted(results.rglob("rostest-*.xml"))]
    passed, failed = sum(p for p, _ in tests), sum(f for _, f in tests + launches)
    if not failed and (run.returncode or not passed):
        failed = 1
        FAILED.append(f"{test.name}: exit code {run.returncode}, {passed} passed")
    print(f"{test.name}: {passed} passed, {failed} failed in {time.monotonic() - started:.0f} s", flush=True)
    for line in (line for file in sorted(results.rglob("rosunit-*.xml")) for line in said(file)):
        print(f"  {line[:LINE]}", flush=True)
    if failed:
        print(output[-20000:], flush=True)
    return passed, failed


def main(selection: list[str]) -> int:
    """Run what was selected; return the exit code."""
    shutil.rmtree(RESULTS, ignore_errors=True)
    RESULTS.mkdir(parents=True)
    totals = []
    with MachineProbe(REALTIME, LOOK) as probe:
        if not selection or "unit" in selection:
            totals.append(run_unit(probe))
        for test in sorted((ROOT / "test" / "integration").glob("*.test")):
            if not selection or "integration" in selection or test.stem in selection:
                totals.append(undisturbed(test.name, lambda: run_rostest(test), probe))
    passed, failed = sum(p for p, _ in totals), sum(f for _, f in totals)
    # again at the end, where whoever looks at a long log looks first
    if DISTURBED:
        print(
            f"{len(DISTURBED)} runs failed while the machine stood still, and were made again: {', '.join(DISTURBED)}"
        )
    for line in FAILED:
        print(f"FAILED {line}")
    print(f"{passed} passed, {failed} failed")
    return 1 if failed or not passed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
