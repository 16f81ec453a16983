"""The clock of searches and plans where a caller gives none."""

from __future__ import annotations

import time
from collections.abc import Callable

#: Returns seconds from any fixed origin.
Clock = Callable[[], float]

MONOTONIC: Clock = time.monotonic
