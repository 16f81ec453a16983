"""Runs every test and ends with `N passed, N failed`: `python scripts/run_tests.py [WORD...]`.

| word | what is run |
|---|---|
| none | everything |
| `lint`, `unit`, `browser`, `integration` | these parts |
| a name | the file of that name in test/integration |
| `fast` | the unit tests that start no other program, as many as fit into three minutes on two cores, by what they took last time |
| `changed`, `changed=COMMIT` | lint, and what a change touches (scripts/touched.py) |

Each tool of scripts/lint.py counts as one test. Unit tests run under pytest, those of the console's page (test/browser) under a
pytest of the venv that drives a browser, each `test/integration/*.test` under rostest with a ROS master of its own. A rostest that
yields no result counts as one failure.

Lint, the unit tests that need no real time and those of the page run beside each other, the unit tests in two processes per core
(pytest-xdist), the file that took longest last time first: what each took is kept in `.ws/test_durations.json`. A file stays in one
process, because its tests may share a broker, a port or what a fixture made. Whatever runs at 250 Hz has a core to itself: the unit
tests of it run one file per core at a time, the launch tests, whose programs fill the machine, one after the other. A probe per
core (benchmarks/machine.py) watches: if the machine runs no process for `HALT`, arm and gateway brake as they should, and a test
that expects a finished motion fails without a fault of ours. Such a failure shows nothing: it is reported, and the test is run
again, `AGAIN` times at most. A failure counts if the machine ran meanwhile, or if the probe has no priority above the tested
processes.
"""

from __future__ import annotations

import os
import queue
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "benchmarks"))

import durations  # noqa: E402
import lint  # noqa: E402
import touched  # noqa: E402
from machine import MachineProbe  # noqa: E402

RESULTS = ROOT / ".ws" / "test_results"
#: The Python that drives a browser; `setup/setup.sh tests` makes it.
BROWSER_PYTHON = ROOT / ".ws" / "browser" / "bin" / "python"
#: Longest that one rostest may take [s]; each test in it has a limit of its own.
TIME_LIMIT = 600
#: Longest line about a failed test, of the list at the end [characters].
LINE = 300
#: Which runs were made again.
DISTURBED: list[str] = []
#: What each file of tests took in this run [s], by its path; of a file that was run again, the last run.
TOOK: dict[str, float] = {}
#: Processes of unit tests per core: a third of their time is waiting, for a program to start or for a silence to be noticed. And
#: most of them at all, for the memory that each takes.
PER_CORE, MOST = 2, 6
#: pytest-xdist hands out whole files, in the order in which they are given.
IN_ORDER = ("--dist", "loadfile", "--no-loadscope-reorder")
#: Result files of this family say of each test in which file it stands.
BY_FILE = ("-o", "junit_family=xunit1")
#: A failure shows nothing if a core ran no process for this long [ms]; the test is then run again, so many times at most. The
#: monitor calls a pose stale after 100 ms. Pauses of 20 ms are usual on a shared machine, and the tests allow for them. Linux stops
#: real-time processes that took 95 % of a second for 50 ms: that would be our fault, so the limit is higher.
HALT, AGAIN = 60.0, 3
#: Period of the probe [ns]: short enough to see such a pause, long enough to take little time from the tests.
PROBE_PERIOD = 2_000_000
#: Highest SCHED_FIFO priority of the nodes; the probe stands above it.
REALTIME = 50
#: Unit tests that run gateway, mock controller or bridge as processes in real time: they need the machine for themselves.
ALONE = (
    "test_faults_",
    "test_fuzz",
    "test_gateway_program",
    "test_gateway_service",
    "test_mock_node",
    "test_mock_udp",
    "test_other_pc",
    "test_tool_udp",
)
#: Those of them that start a whole bringup, more than one core of a slow host carries: one after the other, on every core.
EVERY_CORE = ("test_other_pc",)


@dataclass(frozen=True)
class Result:
    """What tests came to.

    Attributes:
        passed, failed: How many.
        failures: What failed and why, a line each.
    """

    passed: int = 0
    failed: int = 0
    failures: tuple[str, ...] = ()

    @staticmethod
    def total(results: Iterable[Result]) -> Result:
        """Return what several runs came to together."""
        every = list(results)
        failures = tuple(line for one in every for line in one.failures)
        return Result(sum(one.passed for one in every), sum(one.failed for one in every), failures)

    @staticmethod
    def failure(line: str) -> Result:
        """Return one failure and nothing that passed."""
        return Result(0, 1, (line[:LINE],))


def count(file: Path) -> Result:
    """Return what a JUnit file says; a missing, broken or empty one is a failure."""
    try:
        root = ElementTree.parse(file).getroot()
    except (OSError, ElementTree.ParseError) as error:
        return Result.failure(f"{file}: {error}")
    suites = list(root.iter("testsuite"))
    failures = []
    for case in root.iter("testcase"):
        for verdict in (*case.findall("failure"), *case.findall("error")):
            words = (verdict.get("message") or verdict.text or "").strip().splitlines()
            failures.append(f"{case.get('classname')}.{case.get('name')}: {words[0] if words else 'no message'}"[:LINE])
    total = sum(int(suite.get("tests", 0)) for suite in suites)
    failed = sum(int(suite.get("failures", 0)) + int(suite.get("errors", 0)) for suite in suites)
    skipped = sum(int(suite.get("skipped", suite.get("skip", 0))) for suite in suites)
    if not total:
        return Result.failure(f"{file}: no test was run")
    return Result(total - failed - skipped, failed, tuple(failures))


def count_lint(findings: list[lint.Finding]) -> Result:
    """Show what lint found; return it, each tool as one test."""
    failures = []
    for finding in findings:
        print(f"lint, {finding.name}: {'passed' if finding.passed else 'failed'}", flush=True)
        if not finding.passed:
            print(finding.output, flush=True)
            lines = finding.output.strip().splitlines()
            failures.append(f"lint, {finding.name}: {lines[-1] if lines else 'no message'}"[:LINE])
    return Result(len(findings) - len(failures), len(failures), tuple(failures))


def said(file: Path) -> list[str]:
    """Return what the tests of a rostest's result file printed: figures that are reported, not asserted."""
    try:
        root = ElementTree.parse(file).getroot()
    except (OSError, ElementTree.ParseError):
        return []  # `count` makes a failure of it
    # rosunit escapes the marks of a CDATA section as if they were text
    texts = ((part.text or "").replace("<![CDATA[", "").replace("]]>", "") for part in root.iter("system-out"))
    return [line for text in texts for line in text.splitlines() if line.strip()]


def unit_files() -> tuple[list[Path], list[Path]]:
    """Return the files of test/unit that run 250 Hz processes (`ALONE`), and the others."""
    files = sorted((ROOT / "test" / "unit").rglob("test_*.py"))
    alone = [file for file in files if file.stem.startswith(ALONE)]
    return alone, [file for file in files if file not in alone]


def run_beside(files: list[Path], browser: list[Path]) -> list[Result]:
    """Run what needs no real time beside each other: the unit tests in some processes, the page's in one."""
    runs = {}
    if files:
        order = durations.longest_first(files)
        runs["beside"] = start_pytest("beside", order, options=["-n", str(workers()), *IN_ORDER])
    if browser:
        runs["browser"] = start_pytest("browser", browser, BROWSER_PYTHON)
    return [end_pytest(name, run) for name, run in runs.items()]


def workers() -> int:
    """Return in how many processes unit tests run."""
    return min(PER_CORE * len(os.sched_getaffinity(0)), MOST)


def run_alone(files: list[Path]) -> list[Result]:
    """Run the unit tests that start 250 Hz processes: each file on one core, or on every one, which has nothing else to do."""
    waiting: queue.SimpleQueue[Path] = queue.SimpleQueue()

    def one_after_the_other(cores: Sequence[int]) -> list[Result]:
        results = []
        pinned = ("taskset", "--cpu-list", ",".join(map(str, cores)))
        with MachineProbe(REALTIME, PROBE_PERIOD, cores) as probe:
            while True:
                try:
                    file = waiting.get_nowait()
                except queue.Empty:
                    return results
                results.append(
                    undisturbed(
                        file.name,
                        lambda: end_pytest(file.stem, start_pytest(file.stem, [file], before=pinned)),  # noqa: B023
                        probe,
                    )
                )

    every = sorted(os.sched_getaffinity(0))
    results = []
    for whole, parts in ((False, [[core] for core in every]), (True, [every])):
        for file in durations.longest_first(files):
            if file.stem.startswith(EVERY_CORE) is whole:
                waiting.put(file)
        with ThreadPoolExecutor(len(parts)) as threads:
            results += [result for part in threads.map(one_after_the_other, parts) for result in part]
    return results


def undisturbed(name: str, run: Callable[[], Result], probe: MachineProbe) -> Result:
    """Run a test, and again if it fails while the machine stood still; return what the last run came to."""
    for repeats_left in range(AGAIN, -1, -1):
        probe.taken()
        result = run()
        machine = probe.taken()
        if not result.failed or machine["longest_ms"] < HALT or not machine["above"] or not repeats_left:
            break
        DISTURBED.append(name)
        print(
            f"DISTURBED {name}: the machine ran no process on a core for up to {machine['longest_ms']:.0f} ms "
            f"({HALT:.0f} ms spoil a run); {result.failed} failed, not counted; once more",
            flush=True,
        )
        for line in result.failures:
            print(f"not counted: {line}", flush=True)
    return result


def start_pytest(
    name: str,
    files: list[Path],
    python: Path | str = sys.executable,
    options: Sequence[str] = (),
    before: Sequence[str] = (),
) -> subprocess.Popen:
    """Start pytest on some files, by the program `before` if there is one; its result goes to ``unit_<name>.xml``."""
    command = [
        *before,
        str(python),
        "-m",
        "pytest",
        "-q",
        "--timeout=300",
        f"--junitxml={RESULTS / f'unit_{name}.xml'}",
    ]
    command += [*BY_FILE, "-p", "no:cacheprovider", "--durations=10", *options, *map(str, files)]
    with open(RESULTS / f"unit_{name}.log", "wb") as log:
        return subprocess.Popen(command, cwd=ROOT, stdout=log, stderr=subprocess.STDOUT)


def end_pytest(name: str, run: subprocess.Popen) -> Result:
    """Wait for a pytest, show its output and count its results."""
    run.wait()
    print((RESULTS / f"unit_{name}.log").read_text(errors="replace"), flush=True)
    result = count(RESULTS / f"unit_{name}.xml")
    TOOK.update(durations.of_junit(RESULTS / f"unit_{name}.xml"))
    if run.returncode and not result.failed:
        ended = Result.failure(f"unit_{name}: pytest ended with exit code {run.returncode}")
        return Result.total([result, ended])
    return result


def run_rostest(test: Path) -> Result:
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
    tests = Result.total(count(file) for file in sorted(results.rglob("rosunit-*.xml")))
    launches = Result.total(count(file) for file in sorted(results.rglob("rostest-*.xml")))
    # that a rostest could be run is no test that passed
    result = Result(tests.passed, tests.failed + launches.failed, tests.failures + launches.failures)
    if not result.failed and (run.returncode or not result.passed):
        ended = Result.failure(f"{test.name}: exit code {run.returncode}, {result.passed} passed")
        result = Result.total([result, ended])
    took = TOOK[f"test/integration/{test.name}"] = time.monotonic() - started
    print(f"{test.name}: {result.passed} passed, {result.failed} failed in {took:.0f} s", flush=True)
    for line in (line for file in sorted(results.rglob("rosunit-*.xml")) for line in said(file)):
        print(f"  {line[:LINE]}", flush=True)
    if result.failed:
        print(output[-20000:], flush=True)
    return result


@dataclass(frozen=True)
class Selection:
    """What is run.

    Attributes:
        beside, alone: Files of unit tests that need no real time, and of those that run 250 Hz processes.
        browser: Files, or the folder, of the page's tests.
        integration: Rostests.
    """

    lint: bool
    beside: list[Path]
    alone: list[Path]
    browser: list[Path]
    integration: list[Path]


def select(words: list[str]) -> Selection:
    """Return what the words of the command line mean; see the module."""
    alone, beside = unit_files()
    rostests = sorted((ROOT / "test" / "integration").glob("*.test"))
    page = [ROOT / "test" / "browser"]
    since = next((word for word in words if word == "changed" or word.startswith("changed=")), "")
    if since:
        found = [ROOT / path for path in touched.touched_by_a_change(since.partition("=")[2])]
        return Selection(
            True,
            [file for file in beside if file in found],
            [file for file in alone if file in found],
            [file for file in found if file.parent == page[0]],
            [file for file in rostests if file in found],
        )
    if "fast" in words:
        return Selection("lint" in words, durations.fast(beside), [], [], [])
    unit = not words or "unit" in words
    return Selection(
        not words or "lint" in words,
        beside if unit else [],
        alone if unit else [],
        page if not words or "browser" in words else [],
        [test for test in rostests if not words or "integration" in words or test.stem in words],
    )


def main(words: list[str]) -> int:
    """Run what was selected; return the exit code."""
    shutil.rmtree(RESULTS, ignore_errors=True)
    RESULTS.mkdir(parents=True)
    chosen = select(words)
    began = time.monotonic()
    parts: dict[str, float] = {}

    def part(name: str) -> None:
        parts[name] = time.monotonic() - began - sum(parts.values())

    tools = lint.start() if chosen.lint else {}
    results = run_beside(chosen.beside, chosen.browser)
    # before anything runs at 250 Hz
    results.append(count_lint(lint.end(tools)))
    part("lint, unit tests, page")
    if chosen.alone:
        results += run_alone(chosen.alone)
        part("unit tests at 250 Hz")
    if chosen.integration:
        with MachineProbe(REALTIME, PROBE_PERIOD) as probe:
            results += [undisturbed(test.name, lambda: run_rostest(test), probe) for test in chosen.integration]
            part("launch tests")
    durations.keep(TOOK)
    total = Result.total(results)
    # again at the end, which is read first in a long log
    print(durations.table(TOOK, parts))
    if DISTURBED:
        print(
            f"{len(DISTURBED)} runs failed while the machine stood still, and were made again: {', '.join(DISTURBED)}"
        )
    for line in total.failures:
        print(f"FAILED {line}")
    print(f"{total.passed} passed, {total.failed} failed")
    return 1 if total.failed or not total.passed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
