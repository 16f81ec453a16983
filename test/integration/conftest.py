"""Runs the launch tests under pytest: each `.test` file is one test, which passes when rostest and every test in it do."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import pytest
from realtime import pytest_runtest_protocol  # noqa: F401

collect_ignore_glob = ["*.py"]
RESULTS = Path(__file__).resolve().parents[2] / ".ws" / "test_results"
#: Longest that one rostest may take [s].
TIME_LIMIT = 600


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> pytest.Collector | None:
    """Take each launch file for a test."""
    return LaunchFile.from_parent(parent, path=file_path) if file_path.suffix == ".test" else None


class LaunchFile(pytest.File):
    """A launch file with one test."""

    def collect(self) -> Iterator[pytest.Item]:
        """Return the test."""
        launch = Launch.from_parent(self, name=self.path.stem)
        launch.add_marker("realtime")
        yield launch


class LaunchFailure(Exception):
    """What failed in a rostest."""


class Launch(pytest.Item):
    """A rostest; it prints the figures that its tests report."""

    def runtest(self) -> None:
        """Run it; raise LaunchFailure where a test failed, or none was run."""
        results = RESULTS / self.name
        shutil.rmtree(results, ignore_errors=True)
        # the tests' verdicts, logs and configurations do not belong among the user's
        environment = os.environ | {"ROS_HOME": str(results / "ros_home")}
        command = ["rostest", f"--results-base-dir={results}", "construction_twin", self.path.name]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True, "errors": "replace"}
        run = subprocess.Popen(command, env=environment, **pipes)
        try:
            output, _ = run.communicate(timeout=TIME_LIMIT)
        except subprocess.TimeoutExpired:
            run.send_signal(signal.SIGINT)  # lets it end its nodes
            output, _ = run.communicate()
        # rosunit-*.xml: the tests; rostest-*.xml: whether they could be run at all, which is no test that passed
        passed, failures = 0, []
        for file in sorted(results.rglob("ros*-*.xml")):
            try:
                root = ElementTree.parse(file).getroot()
            except ElementTree.ParseError as error:
                failures.append(f"{file}: {error}")
                continue
            for case in root.iter("testcase"):
                wrong = [*case.findall("failure"), *case.findall("error")]
                failures += [f"{case.get('name')}: {(one.get('message') or one.text or '').strip()}" for one in wrong]
                passed += file.name.startswith("rosunit") and not wrong
            for part in root.iter("system-out") if file.name.startswith("rosunit") else ():
                # rosunit escapes the marks of a CDATA section as if they were text
                said = (part.text or "").replace("<![CDATA[", "").replace("]]>", "").splitlines()
                print("\n".join(f"  {line}" for line in said if line.strip()))
        if failures or run.returncode or not passed:
            print(output[-20000:])
            said = "; ".join(failures) or f"{passed} passed"
            raise LaunchFailure(f"exit code {run.returncode}: {said}")

    def repr_failure(self, excinfo: pytest.ExceptionInfo) -> str:
        """Return what failed, without the lines of this file."""
        return str(excinfo.value) if excinfo.errisinstance(LaunchFailure) else str(excinfo.getrepr())

    def reportinfo(self) -> tuple[Path, None, str]:
        """Return where the test stands."""
        return self.path, None, self.name
