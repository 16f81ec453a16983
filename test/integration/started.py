"""A program that a launch test starts itself, roslaunch above all, and what it has on the screen."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import tempfile

#: Option of prctl(2): which signal to get when the parent ends.
_PDEATHSIG = 1


class Started:
    """A process outside of the test's namespace that ends with the test, also when that is killed at its time limit."""

    def __init__(self, *command: str, **environment: str):
        self._screen = tempfile.TemporaryFile()
        prctl = ctypes.CDLL(None).prctl
        self.process = subprocess.Popen(
            command,
            env={name: value for name, value in os.environ.items() if name != "ROS_NAMESPACE"} | environment,
            stdout=self._screen,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            preexec_fn=lambda: prctl(_PDEATHSIG, signal.SIGINT),
        )

    def said(self, since: int = 0) -> str:
        """Return what it has printed behind so many bytes."""
        return os.pread(self._screen.fileno(), self._printed - since, since).decode(errors="replace")

    @property
    def _printed(self) -> int:
        return os.fstat(self._screen.fileno()).st_size

    def end(self, patience: float = 40.0) -> str:
        """End it as Ctrl-C in its terminal does, if it still runs; return what it printed from then on."""
        before = self._printed
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGINT)
            self.process.wait(patience)
        return self.said(before)

    def finish(self, limit: float) -> str:
        """Wait for its end, end it after `limit` [s], and return all that it printed."""
        try:
            self.process.wait(limit)
        except subprocess.TimeoutExpired:
            self.end()
        return self.said()
