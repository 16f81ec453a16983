"""The clock that searches and plans are measured with where a caller gives none.

What decides about motion is given its time. Standard library only.
"""

from __future__ import annotations

import time
from collections.abc import Callable

#: Returns seconds from any fixed origin.
Clock = Callable[[], float]

MONOTONIC: Clock = time.monotonic
