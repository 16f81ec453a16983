"""The default clock of searches and plans."""

from __future__ import annotations

import time
from collections.abc import Callable

#: Returns seconds from any fixed origin.
Clock = Callable[[], float]

MONOTONIC: Clock = time.monotonic
