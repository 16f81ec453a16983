"""`path` on MQTT: where the tool goes while a plan is played, for who shows it. Pure; SI.

The plan itself leaves `plan` with its verdict; this is what a picture still needs of it, for whoever looks in the middle of a
motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from construction_twin.core.records import decimals, dumped
from construction_twin.link.remote_review import Point, kept_points

#: Decimals of a time [s] and of a place that is drawn [m].
_TIME, _PLACE = 6, 4


@dataclass(frozen=True)
class PathView:
    """A message on <prefix>/<robot>/path: the tool's path of the plan that is played.

    Attributes:
        plan_id: As `execution` of `view` has it.
        times: Of the plan, when the tool is at each point [s].
        tool_path: Of tool0 in base_link [m].
    """

    plan_id: Annotated[str, {"minLength": 1}]
    times: Sequence[float] = decimals(_TIME)
    tool_path: Sequence[Point] = decimals(_PLACE)

    def to_json(self, points: int, keep: Sequence[int] = ()) -> bytes:
        """Return the payload for `path`.

        Args:
            points: It is thinned to at most so many, both ends among them.
            keep: Numbers of points that are kept besides.
        """
        kept = kept_points(len(self.tool_path), points, keep)
        return dumped(PathView(self.plan_id, [self.times[k] for k in kept], [self.tool_path[k] for k in kept]))
