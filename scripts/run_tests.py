"""Runs every test and ends with `N passed, N failed`: `python scripts/run_tests.py [WORD...]`.

| word | what is run |
|---|---|
| none | everything |
| `lint`, `unit`, `browser`, `integration`, `repository` (of `unit`) | these parts |
| a name | the launch test of that name in test/integration |
| `fast` | the shortest unit tests, as many as fit into two minutes on two cores, by what they took last time |
| `changed`, `changed=COMMIT` | lint; unit tests whose code has changed since they ran last (pytest-testmon); by `TOUCHES`, more |
| `mutations`, `scenarios`, `soak` | scripts/NAME.py with the words behind it |
| `fuzz [COUNT [SEED]]` | hostile messages and telegrams at a running gateway, a million each |
| `properties` | the property tests with new random examples; pytest's words behind it |

`changed` looks at what has changed since the branch left `origin/main`, or since a commit.

Everything is pytest; each tool of `LINT` and each launch test counts as one test. Lint, the unit tests that need no real time and
those of the page (test/browser, in a venv that drives a browser) run beside each other, whole files, the file that took longest
last time first: a run keeps what each took in `.ws/test_durations.json`; a fresh checkout begins with test/durations.json, a copy
of such a file. Unit tests at 250 Hz (mark `realtime`) have a core each, then the launch tests run two at a time, and at last
those of `ALONE`, one after the other.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / ".ws" / "test_results"
BROWSER_PYTHON = ROOT / ".ws" / "browser" / "bin" / "python"
KEPT, SHIPPED = ROOT / ".ws" / "test_durations.json", ROOT / "test" / "durations.json"
#: What checks the sources without running them; the settings are in pyproject.toml and .importlinter.
LINT = {
    "ruff check": ("ruff", "check"),
    "ruff format": ("ruff", "format", "--check"),
    "import-linter": ("lint-imports", "--no-logo", "--no-cache"),
    "mypy": ("mypy",),
    "size": ("python", "scripts/size.py", "--check"),
}
#: Longest line about a failed test in the list at the end [characters].
LINE = 300
#: Processes of unit tests per core, a third of whose time is waiting, and most of them, for the memory that each takes.
PER_CORE, MOST = 2, 6
#: What a file counts that is not in the list of durations [s]; processor time of the fast tests, and of the longest among them.
SHORT, FAST, LONGEST_FAST = 0.5, 240.0, 10.0
#: Launch tests that count rates or late replies, or whose strings have no stamps: nothing runs beside them.
ALONE = ("bare_plc", "experiment", "physics_twin")
#: The launch tests of a folder; `unit`, `repository`: all of these, because testmon sees Python only; `realtime`: those at 250 Hz.
TOUCHES = {
    "src/construction_twin/core": "realtime kill",
    "src/construction_twin/validation.py": "realtime kill",
    "src/construction_twin/controller": "realtime kill",
    "src/construction_twin/rsi": "realtime kill",
    "src/construction_twin/gateway": "realtime kill",
    "src/construction_twin/mock": "realtime kill",
    "src/construction_twin/mqtt": "realtime kill site bare_plc",
    "src/construction_twin/broker": "site",
    "src/construction_twin/link": "kill bare_plc",
    "src/construction_twin/execution": "motion review",
    "src/construction_twin/review": "review",
    "src/construction_twin/monitor": "review",
    "src/construction_twin/planning": "motion track",
    "src/construction_twin/kinematics": "track another_arm",
    "src/construction_twin/robot": "another_arm track",
    "src/construction_twin/scene": "motion two_robots",
    "src/construction_twin/scenario": "scenario_estop",
    "src/construction_twin/evaluation": "experiment",
    "src/construction_twin/servo": "kill physics_twin",
    "src/construction_twin/twin": "kill physics_twin",
    "src/construction_twin/views": "motion operator",
    "src/construction_twin/ros": "kill motion operator",
    "src/construction_twin/extensions/work": "work_tasks",
    "src/construction_twin/extensions/physics": "physics_twin rehearsal",
    "src/construction_twin/extensions/console": "operator browser",
    "src/construction_twin/extensions/planners": "follow_joint_trajectory",
    "config/scenarios": "scenario_estop",
    "config": "unit",
    "launch": "unit kill two_robots",
    "nodes": "repository kill",
    "docs": "repository",
    "krl": "unit",
    "matlab": "repository",
    "moveit": "repository",
    ".importlinter": "repository",
    "models": "unit",
    "msg": "unit",
    "srv": "unit",
    "urdf": "unit track",
    "setup": "unit",
    "CMakeLists.txt": "unit",
    "package.xml": "unit",
    "pyproject.toml": "unit",
    "test/support/unit_fixtures.py": "unit",
    "test/browser": "browser",
    "web": "browser",
}

Result = tuple[int, list[str]]
#: What each file of tests took [s].
TOOK: dict[str, float] = {}


class Run:
    """A pytest under way; its output and its result go to `RESULTS`."""

    def __init__(self, name: str, files: list[Path], *options: str, python: str | Path = sys.executable):
        self.name = name
        self._may_be_empty = "--testmon" in options
        # xunit1 says of each test in which file it stands
        command = [python, "-m", "pytest", "-q", f"--junitxml={RESULTS / name}.xml", "-o", "junit_family=xunit1"]
        command += ["-p", "no:cacheprovider", "--durations=10", *options, *files]
        self._log = RESULTS / f"{name}.log"
        output = None if "-v" in options else self._log.open("wb")
        environment = os.environ | {"TESTMON_DATAFILE": str(ROOT / ".ws" / "testmon")}
        self._process = subprocess.Popen(
            list(map(str, command)), cwd=ROOT, env=environment, stdout=output, stderr=output
        )

    def end(self) -> Result:
        """Wait for the end, show the output and count."""
        code = self._process.wait()
        if self._log.exists():
            print(self._log.read_text(errors="replace"), flush=True)
        passed, failures = 0, []
        try:
            cases = list(ElementTree.parse(RESULTS / f"{self.name}.xml").getroot().iter("testcase"))
        except (OSError, ElementTree.ParseError) as error:
            return 0, [f"{self.name}: {error}"]
        for case in cases:
            verdicts = [*case.findall("failure"), *case.findall("error")]
            for verdict in verdicts:
                words = (verdict.get("message") or verdict.text or "").strip().splitlines() or ["no message"]
                failures.append(f"{case.get('classname')}.{case.get('name')}: {words[0]}"[:LINE])
            passed += not verdicts and case.find("skipped") is None
            name = case.get("file", "")
            TOOK[name] = TOOK.get(name, 0.0) + float(case.get("time", 0.0))
        # 5: nothing was selected
        is_fine = code in (0, 5) if self._may_be_empty else code == 0 and passed
        if not failures and not is_fine:
            failures.append(f"{self.name}: exit code {code}, {passed} passed")
        return passed, failures


def start_lint() -> dict[str, subprocess.Popen]:
    """Start every tool of `LINT`."""
    environment = os.environ | {"PYTHONPATH": str(ROOT / "src"), "NO_COLOR": "1"}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    # the programs lie beside the interpreter, in the venv
    return {
        name: subprocess.Popen([Path(sys.executable).parent / program, *words], cwd=ROOT, env=environment, **pipes)
        for name, (program, *words) in LINT.items()
    }


def lint_result(runs: dict[str, subprocess.Popen]) -> Result:
    """Wait for the tools of lint and show what they found; each is one test."""
    failed = []
    for name, run in runs.items():
        output, _ = run.communicate()
        print(f"lint, {name}:", f"failed\n{output}" if run.returncode else "passed", flush=True)
        failed += [f"lint, {name}"] if run.returncode else []
    return len(runs) - len(failed), failed


def touched(since: str) -> set[str]:
    """Return what has changed, the words of `TOUCHES` for it, and the launch tests whose own files are among it."""

    def git(*words: str) -> list[str]:
        return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()

    commit = since or git("merge-base", "HEAD", "origin/main")[0]
    changed = [*git("diff", "--name-only", commit, "--"), *git("ls-files", "--others", "--exclude-standard")]
    found = {
        word
        for path in changed
        for folder, words in TOUCHES.items()
        if path.startswith(folder)
        for word in words.split()
    }
    names = {Path(path).stem for path in changed if path.startswith("test/integration/")}
    texts = {test.stem: test.read_text() for test in (ROOT / "test/integration").glob("*.test")}
    return found | {test for test, text in texts.items() for name in names if name == test or name in text} | {*changed}


def other(words: list[str]) -> int | None:
    """Run what is no test of every day; return its exit code, None for other words."""
    environment, pytest = dict(os.environ), [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
    match words:
        case ["mutations" | "scenarios" | "soak" as name, *rest]:
            command = [sys.executable, ROOT / "scripts" / f"{name}.py", *rest]
        case ["fuzz", *rest]:
            count, seed, *_ = [*rest, *["1000000", "1"][len(rest) :]]
            environment |= {"FUZZ_COUNT": count, "FUZZ_SEED": seed}
            command = [*pytest, "-s", "test/unit/gateway/test_fuzz.py"]
        case ["properties", *rest]:
            environment |= {"HYPOTHESIS_PROFILE": "random"}
            every = [*(ROOT / "test/unit").rglob("test_*.py"), *(ROOT / "test/extensions").rglob("test_*.py")]
            command = [*pytest, *(file for file in every if "\nfrom hypothesis" in file.read_text()), *rest]
        case _:
            return None
    return subprocess.run(command, cwd=ROOT, env=environment).returncode


def main(words: list[str]) -> int:
    """Run what was selected; return the exit code."""
    if (code := other(words)) is not None:
        return code
    shutil.rmtree(RESULTS, ignore_errors=True)
    RESULTS.mkdir(parents=True)
    known = json.loads((KEPT if KEPT.exists() else SHIPPED).read_text())

    def took(file: Path) -> float:
        return known.get(file.relative_to(ROOT).as_posix(), SHORT)

    found = [*(ROOT / "test" / "unit").rglob("test_*.py"), *(ROOT / "test" / "extensions").rglob("test_*.py")]
    every = sorted(found, key=lambda file: (-took(file), file))
    alone = [file for file in every if "mark.realtime" in file.read_text()]
    unit = [file for file in every if file not in alone]
    launches = sorted((ROOT / "test" / "integration").glob("*.test"), key=lambda test: -took(test))
    known_words = {"lint", "unit", "browser", "integration", "repository", "fast", *(test.stem for test in launches)}
    if unknown := [word for word in words if word.partition("=")[0] not in known_words | {"changed"}]:
        sys.exit(f"no such tests: {', '.join(unknown)}")
    options: list[str] = []
    if change := next((word for word in words if word.partition("=")[0] == "changed"), None):
        words = ["lint", *touched(change.partition("=")[2])]
        options = [] if "unit" in words else ["--testmon"]
        if not {"realtime", "unit"} & set(words):
            alone = [file for file in alone if file.relative_to(ROOT).as_posix() in words]
    elif "fast" in words:
        left, fast = FAST, []
        for file in reversed(unit):
            left -= took(file)
            if left < 0 or took(file) > LONGEST_FAST:
                break
            fast.append(file)
        unit, alone = fast, []
    elif words and "unit" not in words:
        unit, alone = [], []
    launches = [test for test in launches if not words or "integration" in words or test.stem in words]
    began = time.monotonic()
    linting = start_lint() if not words or "lint" in words else {}
    workers = min(PER_CORE * len(os.sched_getaffinity(0)), MOST)
    runs = []
    if unit:
        runs.append(
            Run("unit", unit, "--timeout=300", f"-n{workers}", "--dist=loadfile", "--no-loadscope-reorder", *options)
        )
    if "repository" in words and "unit" not in words:
        runs.append(Run("repository", [ROOT / "test" / "unit" / "repository"], "--timeout=300", "-n2"))
    if not words or "browser" in words:
        runs.append(Run("browser", [ROOT / "test" / "browser"], "--timeout=300", python=BROWSER_PYTHON))
    results = [run.end() for run in runs]
    results.append(lint_result(linting))  # before anything runs at 250 Hz
    parts = {"lint, unit tests, page": time.monotonic() - began}
    cores = f"-n{len(os.sched_getaffinity(0))}"
    if alone:
        results.append(Run("realtime", alone, "--timeout=300", cores, "--maxschedchunk=1").end())
    parts["unit tests at 250 Hz"] = time.monotonic() - began - sum(parts.values())
    beside = [test for test in launches if test.stem not in ALONE]
    if beside:
        results.append(Run("launch", beside, "-v", "-rP", "-n2", "--maxschedchunk=1").end())
    parts["launch tests, two at a time"] = time.monotonic() - began - sum(parts.values())
    if len(beside) < len(launches):
        results.append(Run("launch_alone", [test for test in launches if test.stem in ALONE], "-v", "-s").end())
    parts["launch tests, one at a time"] = time.monotonic() - began - sum(parts.values())
    now = {name: round(seconds, 1) for name, seconds in sorted((known | TOOK).items()) if (ROOT / name).is_file()}
    KEPT.write_text(json.dumps({name: seconds for name, seconds in now.items() if seconds > SHORT}, indent=1) + "\n")
    for name, seconds in [*parts.items(), *sorted(TOOK.items(), key=lambda item: -item[1])[:20]]:
        print(f"{seconds:7.0f} s  {name}")
    passed, failures = sum(one for one, _ in results), [line for _, lines in results for line in lines]
    for line in failures:
        print(f"FAILED {line}")
    print(f"{passed} passed, {len(failures)} failed")
    return 1 if failures or not passed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
