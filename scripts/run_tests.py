"""Runs every test and ends with `N passed, N failed`: `python scripts/run_tests.py [WORD...]`.

| word | what is run |
|---|---|
| none | everything |
| `lint`, `unit`, `browser`, `integration` | these parts |
| a name | the file of that name in test/integration |
| `fast` | the shortest unit tests, as many as fit into two minutes on two cores, by what they took last time |
| `changed`, `changed=COMMIT` | lint, and what a change touches: since the branch left `origin/main`, or since a commit |

Each tool of scripts/lint.py counts as one test. Lint, the unit tests that need no real time and those of the page (test/browser, in
a venv that drives a browser) run beside each other, whole files, the file that took longest last time first: a run keeps what each
took in `.ws/test_durations.json`; a fresh checkout begins with test/durations.json, a copy of such a file. Unit tests that run
processes at 250 Hz (`ALONE`) have a core each, then the launch tests run one after the other. A probe per core
(benchmarks/machine.py) watches: a test that failed while a core ran no process for `HALT` shows nothing and is run again.
"""

from __future__ import annotations

import ast
import json
import os
import queue
import re
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

import grimp
import lint

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "benchmarks"))

from machine import MachineProbe  # noqa: E402

RESULTS = ROOT / ".ws" / "test_results"
BROWSER_PYTHON = ROOT / ".ws" / "browser" / "bin" / "python"
KEPT, SHIPPED = ROOT / ".ws" / "test_durations.json", ROOT / "test" / "durations.json"
#: Longest that one rostest may take [s].
TIME_LIMIT = 600
#: Longest line about a failed test in the list at the end [characters].
LINE = 300
#: Processes of unit tests per core, a third of whose time is waiting, and most of them, for the memory that each takes.
PER_CORE, MOST = 2, 6
#: What a file counts that is not in the list of durations [s]; processor time of the fast tests, and of the longest among them.
SHORT, FAST, LONGEST_FAST = 0.5, 240.0, 10.0
#: A failure beside such a pause of a core [ms] shows nothing; runs that are made again at most. The monitor calls a pose stale at
#: 100 ms; pauses of 20 ms are usual on a shared machine, and Linux itself stops real-time processes for 50 ms.
HALT, AGAIN = 60.0, 3
#: Period of the probe [ns], and the highest SCHED_FIFO priority of the nodes, above which it stands.
PROBE_PERIOD, REALTIME = 2_000_000, 50
#: Unit tests that run gateway, mock controller or bridge as processes in real time.
ALONE = (
    "test_faults_",
    "test_fuzz",
    "test_gateway_program",
    "test_gateway_service",
    "test_mock_node",
    "test_mock_udp",
)
#: A change of one of these touches every unit test.
EVERYTHING = re.compile(r"pyproject\.toml|setup/|test/support/unit_fixtures\.py|CMakeLists\.txt|package\.xml|msg/|srv/")


@dataclass(frozen=True)
class Result:
    """What tests came to; of each failure a line."""

    passed: int = 0
    failures: tuple[str, ...] = ()

    def __add__(self, other: Result) -> Result:
        return Result(self.passed + other.passed, self.failures + other.failures)

    def ended(self, name: str, code: int | None) -> Result:
        """Return this with a failure more if a program failed and no test of it did, or if nothing was run."""
        wrong = not self.failures and (code or not self.passed)
        return self + Result(0, (f"{name}: exit code {code}, {self.passed} passed",)) if wrong else self


#: Which runs were made again, and what each file of tests took [s].
DISTURBED: list[str] = []
TOOK: dict[str, float] = {}


def count(file: Path) -> Result:
    """Return what a JUnit file says; a missing or broken one is a failure."""
    try:
        root = ElementTree.parse(file).getroot()
    except (OSError, ElementTree.ParseError) as error:
        return Result(0, (f"{file}: {error}",))
    passed, failures = 0, []
    for case in root.iter("testcase"):
        verdicts = [*case.findall("failure"), *case.findall("error")]
        for verdict in verdicts:
            words = (verdict.get("message") or verdict.text or "").strip().splitlines()
            failures.append(f"{case.get('classname')}.{case.get('name')}: {words[0] if words else 'no message'}"[:LINE])
        passed += not verdicts and case.find("skipped") is None
        if name := case.get("file"):
            TOOK[name] = TOOK.get(name, 0.0) + float(case.get("time", 0.0))
    return Result(passed, tuple(failures))


def count_lint(findings: list[lint.Finding]) -> Result:
    """Show what lint found; return it, each tool as one test."""
    for finding in findings:
        print(f"lint, {finding.name}:", "passed" if finding.passed else f"failed\n{finding.output}", flush=True)
    failed = tuple(f"lint, {finding.name}" for finding in findings if not finding.passed)
    return Result(len(findings) - len(failed), failed)


def start_pytest(name: str, files: Iterable[Path], *options: str, before: Sequence[str] = (), python=sys.executable):
    """Start pytest on files; its result goes to `RESULTS`/<name>.xml, its output beside it."""
    # xunit1 says of each test in which file it stands
    command = [*before, python, "-m", "pytest", "-q", "--timeout=300", f"--junitxml={RESULTS / name}.xml"]
    command += ["-o", "junit_family=xunit1", "-p", "no:cacheprovider", "--durations=10", *options, *files]
    with open(f"{RESULTS / name}.log", "wb") as log:
        return subprocess.Popen([str(word) for word in command], cwd=ROOT, stdout=log, stderr=subprocess.STDOUT)


def end_pytest(name: str, run: subprocess.Popen) -> Result:
    """Wait for a pytest, show its output and count its results."""
    code = run.wait()
    print(Path(f"{RESULTS / name}.log").read_text(errors="replace"), flush=True)
    return count(Path(f"{RESULTS / name}.xml")).ended(name, code)


def run_beside(files: list[Path], browser: list[Path]) -> Result:
    """Run what needs no real time beside each other: the unit tests in some processes, the page's in one."""
    runs = {}
    if files:
        workers = min(PER_CORE * len(os.sched_getaffinity(0)), MOST)
        runs["unit"] = start_pytest("unit", files, f"-n{workers}", "--dist=loadfile", "--no-loadscope-reorder")
    if browser:
        runs["browser"] = start_pytest("browser", browser, python=BROWSER_PYTHON)
    return sum((end_pytest(name, run) for name, run in runs.items()), Result())


def run_alone(files: list[Path]) -> Result:
    """Run unit tests that start 250 Hz processes: each file on a core that has nothing else to do."""
    every = sorted(os.sched_getaffinity(0))
    free: queue.SimpleQueue[list[int]] = queue.SimpleQueue()

    def on_free(file: Path) -> Result:
        cores = free.get()
        pinned = ("taskset", "--cpu-list", ",".join(map(str, cores)))

        def run() -> Result:
            return end_pytest(file.stem, start_pytest(file.stem, [file], before=pinned))

        try:
            with MachineProbe(REALTIME, PROBE_PERIOD, cores) as probe:
                return undisturbed(file.name, run, probe)
        finally:
            free.put(cores)

    for core in every:
        free.put([core])
    with ThreadPoolExecutor(len(every)) as threads:
        return sum(threads.map(on_free, files), Result())


def undisturbed(name: str, run: Callable[[], Result], probe: MachineProbe) -> Result:
    """Run a test, and again if it fails while the machine stood still; return what the last run came to."""
    for repeats_left in range(AGAIN, -1, -1):
        probe.taken()
        result = run()
        machine = probe.taken()
        if not result.failures or machine["longest_ms"] < HALT or not machine["above"] or not repeats_left:
            break
        DISTURBED.append(name)
        print(f"DISTURBED {name}: a core ran no process for {machine['longest_ms']:.0f} ms; once more", flush=True)
        print("\n".join(f"not counted: {line}" for line in result.failures), flush=True)
    return result


def run_rostest(test: Path) -> Result:
    """Run one rostest; show the figures that it reports, and its output when it fails."""
    results = RESULTS / test.stem
    shutil.rmtree(results, ignore_errors=True)  # of a disturbed run
    started = time.monotonic()
    # the tests' verdicts, logs and configurations do not belong among the user's
    environment = os.environ | {"ROS_HOME": str(results / "ros_home")}
    command = ["rostest", f"--results-base-dir={results}", "construction_twin", test.name]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True, "errors": "replace"}
    run = subprocess.Popen(command, env=environment, **pipes)
    try:
        output, _ = run.communicate(timeout=TIME_LIMIT)
    except subprocess.TimeoutExpired:
        run.send_signal(signal.SIGINT)  # lets it end its nodes
        output, _ = run.communicate()
    # rosunit-*.xml: the tests; rostest-*.xml: whether they could be run at all, which is no test that passed
    files = sorted(results.rglob("rosunit-*.xml"))
    result = sum(map(count, files), Result())
    launches = sum(map(count, sorted(results.rglob("rostest-*.xml"))), Result())
    result = (result + Result(0, launches.failures)).ended(test.name, run.returncode)
    took = TOOK[f"test/integration/{test.name}"] = time.monotonic() - started
    print(f"{test.name}: {result.passed} passed, {len(result.failures)} failed in {took:.0f} s", flush=True)
    for file in files:
        for part in ElementTree.parse(file).iter("system-out"):
            # rosunit escapes the marks of a CDATA section as if they were text
            said = (part.text or "").replace("<![CDATA[", "").replace("]]>", "")
            print("".join(f"  {line[:LINE]}\n" for line in said.splitlines() if line.strip()), end="", flush=True)
    if result.failures:
        print(output[-20000:], flush=True)
    return result


def touched(since: str) -> set[Path]:
    """Return the files of tests that a change touches, by the modules that they import and the files that their texts name.

    Launch tests bring up everything: only those whose own files have changed.
    """

    def git(*words: str) -> list[str]:
        return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()

    commit = since or git("merge-base", "HEAD", "origin/main")[0]
    changed = [*git("diff", "--name-only", commit, "--"), *git("ls-files", "--others", "--exclude-standard")]
    sys.path.insert(0, str(ROOT / "src"))
    graph = grimp.build_graph("construction_twin")
    names: set[str] = set()
    for path in map(Path, changed):
        names.add(path.name)
        module = ".".join(path.with_suffix("").parts[1:]).removesuffix(".__init__")
        if module in graph.modules:
            names |= {module, *graph.find_downstream_modules(module, as_package=path.stem == "__init__")}
        elif path.suffix == ".py":
            names.add(path.stem)
    files = [
        ROOT / path for path in git("ls-files", "test") if path.endswith((".py", ".test")) and (ROOT / path).is_file()
    ]
    leads = {file: _names(file) for file in files}
    # what tests share leads on to those that import it
    while new := {file.stem for file in files if file.suffix == ".py" and leads[file] & names} - names:
        names |= new
    everything = any(EVERYTHING.match(path) for path in changed)
    page = any(path.startswith("web/") for path in changed)
    return {
        file
        for file in files
        if {file.name, *leads[file]} & names
        or (everything and ({"unit", "extensions"} & set(file.parts)))
        or (page and "browser" in file.parts)
    }


def _names(file: Path) -> set[str]:
    """Return the modules that a file of tests imports, and the names of files in its texts."""
    text = file.read_text()
    found = (
        set(re.findall(r"\w[\w.-]*", text)) if file.suffix == ".test" else set(re.findall(r"\w[\w-]*\.[\w.]+", text))
    )
    for node in ast.walk(ast.parse(text)) if file.suffix == ".py" else ():
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def main(words: list[str]) -> int:
    """Run what was selected; return the exit code."""
    shutil.rmtree(RESULTS, ignore_errors=True)
    RESULTS.mkdir(parents=True)
    known = json.loads((KEPT if KEPT.exists() else SHIPPED).read_text())

    def took(file: Path) -> float:
        return known.get(file.relative_to(ROOT).as_posix(), SHORT)

    unit = [file for folder in ("unit", "extensions") for file in (ROOT / "test" / folder).rglob("test_*.py")]
    unit.sort(key=lambda file: (-took(file), file))
    browser = sorted((ROOT / "test" / "browser").glob("test_*.py"))
    rostests = sorted((ROOT / "test" / "integration").glob("*.test"))
    tools = not words or "lint" in words
    if change := next((word for word in words if word.partition("=")[0] == "changed"), None):
        found, tools = touched(change.partition("=")[2]), True
        unit, browser, rostests = ([file for file in files if file in found] for files in (unit, browser, rostests))
    elif "fast" in words:
        left, fast = FAST, []
        for file in reversed(unit):
            left -= took(file)
            if left < 0 or took(file) > LONGEST_FAST:
                break
            fast += [] if file.stem.startswith(ALONE) else [file]
        unit, browser, rostests = fast, [], []
    elif words:
        unit, browser = unit if "unit" in words else [], browser if "browser" in words else []
        rostests = [test for test in rostests if "integration" in words or test.stem in words]
    alone = [file for file in unit if file.stem.startswith(ALONE)]
    began = time.monotonic()
    linting = lint.start() if tools else {}
    result = run_beside([file for file in unit if file not in alone], browser)
    result += count_lint(lint.end(linting))  # before anything runs at 250 Hz
    parts = {"lint, unit tests, page": time.monotonic() - began}
    result += run_alone(alone)
    parts["unit tests at 250 Hz"] = time.monotonic() - began - sum(parts.values())
    if rostests:
        with MachineProbe(REALTIME, PROBE_PERIOD) as probe:
            for test in rostests:
                result += undisturbed(test.name, lambda: run_rostest(test), probe)  # noqa: B023
    parts["launch tests"] = time.monotonic() - began - sum(parts.values())
    now = {name: round(seconds, 1) for name, seconds in sorted((known | TOOK).items()) if (ROOT / name).is_file()}
    KEPT.write_text(json.dumps({name: seconds for name, seconds in now.items() if seconds > SHORT}, indent=1) + "\n")
    for name, seconds in [*parts.items(), *sorted(TOOK.items(), key=lambda item: -item[1])[:20]]:
        print(f"{seconds:7.0f} s  {name}")
    if DISTURBED:
        print(f"{len(DISTURBED)} runs failed while the machine stood still and were made again: {', '.join(DISTURBED)}")
    for line in result.failures:
        print(f"FAILED {line}")
    print(f"{result.passed} passed, {len(result.failures)} failed")
    return 1 if result.failures or not result.passed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
