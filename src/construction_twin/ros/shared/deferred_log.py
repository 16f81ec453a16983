"""Lines for a node's own log, from threads that must not wait: it writes to disk and terminal, under a lock of all threads."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable

#: Lines kept; of more the oldest are dropped.
KEPT = 1000


class DeferredLog:
    """Keeps lines until a thread that may wait writes them."""

    def __init__(self):
        self._writing = threading.Lock()
        self._lines: deque[tuple[Callable[..., None], tuple]] = deque(maxlen=KEPT)

    def add(self, write: Callable[..., None], *words) -> None:
        """Keep a line; `write` is `rospy.loginfo` or one of its kind, `words` its arguments."""
        self._lines.append((write, words))

    def flush(self) -> None:
        """Write what was kept, oldest first."""
        with self._writing:
            while self._lines:
                write, words = self._lines.popleft()
                write(*words)
