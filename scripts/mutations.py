"""Breaks chosen lines one at a time and shows that a named test notices each: `make test ARGS="mutations gateway --workers 1"`.

scripts/mutations.toml names each mutation by the behaviour that it breaks, with the file below src/construction_twin, a text that
stands there once, what takes its place, and the test (below test/) that must fail then. Every worker has a copy of the repository
and breaks that; the checkout stays as it is. Each test is run unbroken first and must pass; broken it must fail by an assertion,
or by a refusal of this package, and not because the broken line makes no sense.

One line per mutation, then ``N caught, N not caught``; the exit code is 1 if one was not caught. A line that moved is never left
out: find it, and break the same behaviour there.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, fields
from multiprocessing.connection import wait
from pathlib import Path
from queue import SimpleQueue
from xml.etree import ElementTree

import tomllib

ROOT = Path(__file__).resolve().parent.parent
LIST = ROOT / "scripts" / "mutations.toml"
PACKAGE = "construction_twin"
#: Longest that one test may take [s].
TIME_LIMIT = 60.0
#: What is not copied: what git does not know, and what no test of the list reads.
LEFT_OUT = shutil.ignore_patterns(".git", ".ws", "results", "node_modules")
#: Processes for tests, forked from one that has imported what takes long: a test of a few lines then takes as long as it takes.
FORKS = multiprocessing.get_context("forkserver")
LIBRARIES = "pytest hypothesis numpy scipy.spatial pydantic yaml paho.mqtt.client pinocchio rospy".split()
FORKS.set_forkserver_preload(LIBRARIES)
#: Starting a process also asks every other one whether it has ended, and the end is told once: two threads that ask at a time may
#: both be answered, one of them with 255 for a process that ended with 0.
_ASKING = threading.Lock()
#: How the message of a failure begins that is an answer to the mutation: pytest's assertions, and this package's own refusals.
ANSWERS = ("assert ", "AssertionError", "Failed: ", f"{PACKAGE}.")
#: Longest quotation of a failure [characters].
LINE = 200


@dataclass(frozen=True)
class Mutation:
    """One behaviour, and how it is broken.

    Attributes:
        behaviour: What holds, in one sentence; the mutation breaks it.
        file: Below src/construction_twin.
        old, new: A text that stands in the file once, and what takes its place.
        test: The pytest id, below test/, of what must fail.
    """

    behaviour: str
    file: str
    old: str
    new: str
    test: str

    def break_in(self, text: str) -> str:
        """Return a file's text with the line broken; raises ValueError where that is not possible."""
        count = text.count(self.old)
        if count != 1:
            found = f"found {count} times" if count else "not found"
            raise ValueError(f"the line moved ({found}): find it, and break the same behaviour there")
        broken = text.replace(self.old, self.new)
        try:
            compile(broken, self.file, "exec")
        except SyntaxError as error:
            raise ValueError(f"the broken line is no Python: {error}") from error
        return broken


@dataclass(frozen=True)
class Outcome:
    """What became of a test: "" where it passed, else how it failed; `by_assertion` where that is an answer to a mutation."""

    failure: str
    by_assertion: bool = False


class Copy:
    """A copy of a repository, in which files are broken and tests run.

    Args:
        folder: Where the copy is made.
        time_limit: Of one test [s].
    """

    def __init__(self, root: Path, folder: Path, time_limit: float = TIME_LIMIT):
        self.package = folder / "src" / PACKAGE
        self._folder, self._time_limit = folder, time_limit
        shutil.copytree(root, folder, ignore=LEFT_OUT, symlinks=True)
        # the generated messages, which catkin puts beside a package of the same name; that one leads to the checkout's sources
        for entry in map(Path, sys.path):
            for name in ("msg", "srv"):
                generated = entry / PACKAGE / name
                if (generated / "__init__.py").exists() and not (self.package / name).exists():
                    shutil.copytree(generated, self.package / name)

    @contextmanager
    def broken(self, mutation: Mutation) -> Iterator[None]:
        """Break a line for as long as the context lasts; raises ValueError where that is not possible."""
        file = self.package / mutation.file
        text, seen = file.read_text(), file.stat()
        file.write_text(mutation.break_in(text))
        # another time than the original's, so that Python compiles it; no second has passed, and the size may be the same
        os.utime(file, ns=(seen.st_atime_ns, seen.st_mtime_ns + 10**10))
        try:
            yield
        finally:
            file.write_text(text)
            os.utime(file, ns=(seen.st_atime_ns, seen.st_mtime_ns))

    def run(self, test: str, keep_compiled: bool) -> Outcome:
        """Run a test up to its first failure; `keep_compiled` leaves compiled modules for the next run, never broken ones."""
        result, output = self._folder / "result.xml", self._folder / "output.txt"
        result.unlink(missing_ok=True)
        process = FORKS.Process(target=_run_pytest, args=(self._folder, test, result, output, keep_compiled))
        with _ASKING:
            process.start()
        if not wait([process.sentinel], self._time_limit):
            os.killpg(process.pid, signal.SIGKILL)
            wait([process.sentinel])
            return Outcome(f"it took more than {self._time_limit:g} s")
        with _ASKING:
            code = process.exitcode
        if code == 0:
            return Outcome("")
        lines = output.read_text(errors="replace").strip().splitlines() or ["no output"]
        return _failure(result) or Outcome(next((line for line in lines if line.startswith("ERROR")), lines[-1])[:LINE])


def _run_pytest(folder: Path, test: str, result: Path, output: Path, keep_compiled: bool) -> None:
    """Run a test of a copy in this process, which has imported libraries, but nothing of the package."""
    os.setsid()
    with open(output, "wb") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    os.chdir(folder)
    path = [str(folder / "src"), *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))]
    os.environ["PYTHONPATH"] = os.pathsep.join(path)  # for the processes that a test starts
    sys.path[:] = [path[0], *(entry for entry in sys.path if entry not in ("", str(ROOT / "scripts")))]
    if not keep_compiled:
        sys.dont_write_bytecode = True
        os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
    import pytest

    options = ["-q", "-x", "-p", "no:cacheprovider", f"--rootdir={folder}", f"--junitxml={result}"]
    os._exit(pytest.main([*options, f"test/{test}"]))


def _failure(result: Path) -> Outcome | None:
    """Return the failure of a JUnit file; None without one."""
    try:
        cases = list(ElementTree.parse(result).getroot().iter("testcase"))
    except (OSError, ElementTree.ParseError):
        return None
    for case in cases:
        for kind in ("failure", "error"):
            for found in case.findall(kind):
                message = (found.get("message") or kind).strip()
                last = (found.text or "").strip().splitlines()[-1:] if kind == "error" else []
                words = ": ".join([message.splitlines()[0], *last])
                return Outcome(words[:LINE], kind == "failure" and message.startswith(ANSWERS))
    return None


def read(file: Path) -> list[Mutation]:
    """Return the mutations of a list; raises ValueError where a key is missing, unknown or no text."""
    names = {field.name for field in fields(Mutation)}
    found = []
    for number, entry in enumerate(tomllib.loads(file.read_text()).get("mutation", []), start=1):
        if set(entry) != names or not all(isinstance(value, str) for value in entry.values()):
            raise ValueError(f"mutation {number} of {file}: expected texts for {', '.join(sorted(names))}")
        found.append(Mutation(**entry))
    return found


def judge(mutation: Mutation, copy: Copy) -> str:
    """Return why a mutation is not caught; "" when it is."""
    if unbroken := copy.run(mutation.test, keep_compiled=True).failure:
        return f"its test fails with nothing broken: {unbroken}"
    try:
        with copy.broken(mutation):
            outcome = copy.run(mutation.test, keep_compiled=False)
    except (OSError, ValueError) as error:
        return str(error)
    if not outcome.failure:
        return "its test still passes"
    return "" if outcome.by_assertion else f"its test fails, but not by an assertion: {outcome.failure}"


def run(mutations: list[Mutation], root: Path, workers: int, time_limit: float = TIME_LIMIT) -> int:
    """Judge mutations, each worker in a copy of its own, and say what was found; return the exit code."""
    copies: SimpleQueue[Copy] = SimpleQueue()

    def timed(mutation: Mutation) -> tuple[str, float]:
        copy, began = copies.get(), time.monotonic()
        try:
            return judge(mutation, copy), time.monotonic() - began
        finally:
            copies.put(copy)

    with tempfile.TemporaryDirectory(prefix="mutations_") as folder, ThreadPoolExecutor(workers) as pool:
        for number in range(workers):
            copies.put(Copy(root, Path(folder) / str(number), time_limit))
        missed = 0
        for mutation, (why, seconds) in zip(mutations, pool.map(timed, mutations)):
            missed += bool(why)
            verdict = "NOT CAUGHT" if why else "caught"
            print(f"{verdict} ({seconds:.1f} s): {mutation.file}: {mutation.behaviour}", flush=True)
            if why:
                print(f"  {why}\n  {mutation.test}", flush=True)
    print(f"{len(mutations) - missed} caught, {missed} not caught")
    return 1 if missed or not mutations else 0


def main(arguments: list[str] | None = None) -> int:
    """Judge the mutations of the list that were selected; return the exit code."""
    parser = argparse.ArgumentParser(prog="make test ARGS=mutations", description=__doc__.splitlines()[0])
    parser.add_argument("word", nargs="*", help="only mutations with one of these words in file, behaviour or test")
    parser.add_argument("--workers", type=int, default=2, help="how many run beside each other [%(default)s]")
    parser.add_argument(
        "--time-limit", type=float, default=TIME_LIMIT, help="longest that one test may take [%(default)g s]"
    )
    options = parser.parse_args(arguments)
    if options.workers < 1:
        parser.error(f"--workers {options.workers}; expected at least 1")
    chosen = [
        mutation
        for mutation in read(LIST)
        if not options.word
        or any(word in " ".join((mutation.file, mutation.behaviour, mutation.test)) for word in options.word)
    ]
    return run(chosen, ROOT, options.workers, options.time_limit)


if __name__ == "__main__":
    sys.exit(main())
