"""The monitor's changes of state for everybody: topic `transitions`, the log file, the node's own log and `/diagnostics`."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path

import rospy

from construction_twin.core.append_only import AppendOnlyFile, iso_time
from construction_twin.core.errors import TransitionLogError
from construction_twin.monitor.states import SyncState, Transition
from construction_twin.msg import Transition as TransitionMsg
from construction_twin.ros.shared.deferred_log import DeferredLog
from construction_twin.ros.transport.joint_stream import to_time
from construction_twin.ros.transport.publisher import Sink

#: Transitions shown on `/diagnostics`, the newest first.
SHOWN = 5
#: Which states are worth a warning, and which an error; the others are part of normal work.
_WARNED = (SyncState.HOLDING, SyncState.REPLANNING, SyncState.STALE)
_SERIOUS = (SyncState.STOPPED, SyncState.FAULT)


class TransitionReport:
    """Publishes and records transitions.

    Args:
        file: Log file.
        names: Joint names.
        publisher: Of `transitions`.

    Attributes:
        problem: Why the log cannot be written; empty when it can.

    Raises:
        ConfigurationError: When the log cannot be opened.
    """

    def __init__(self, file: Path, names: tuple[str, ...], publisher: Sink):
        self.problem = ""
        self.count = 0
        self._names = names
        self._log = AppendOnlyFile(file, TransitionLogError, "pca_monitor")
        self._said = DeferredLog()
        self._recent: deque[Transition] = deque(maxlen=SHOWN)
        self._publisher = publisher
        rospy.loginfo("transitions are recorded in %s", self._log.path)

    def report(self, change: Transition) -> None:
        """Publish a transition and keep it for both logs."""
        self._log.defer(change.at, transition_fields(change, self._names))
        self._recent.appendleft(change)
        self.count += 1
        self._publisher.publish(self._message(change))
        self._said.add(_say(change.target), "%s", change)

    def flush(self) -> None:
        """Write what is kept to the logs; waits for the disk."""
        self._said.flush()
        try:
            self._log.flush()
        except TransitionLogError as error:
            self.problem = str(error)
            rospy.logerr_throttle(5.0, "%s", error)
            return
        self.problem = ""

    def values(self) -> dict[str, str]:
        """Return what `/diagnostics` shows."""
        recent = {
            f"transition {number}": f"{iso_time(change.at)} {change}"
            for number, change in enumerate(tuple(self._recent), start=1)
        }
        log = {"transition log": str(self._log.path), "transitions lost to the log": str(self._log.lost)}
        return {"transitions": str(self.count)} | recent | log

    def _message(self, change: Transition) -> TransitionMsg:
        message = TransitionMsg(
            from_text=change.source.name,
            to_text=change.target.name,
            event=change.event.value,
            reason=change.reason,
            name=self._names,
            held_stamp=to_time(change.held_stamp),
        )
        message.header.stamp = to_time(change.at)
        if change.comparison is not None:
            message.error, message.threshold = change.comparison.error, change.comparison.threshold
        return message


def transition_fields(change: Transition, names: Sequence[str]) -> dict:
    """Return what a line of the log holds of a transition, besides its time; `error` and `threshold` by joint [rad], [m]."""
    last = change.comparison
    return {
        "from": change.source.name,
        "to": change.target.name,
        "event": change.event.value,
        "reason": change.reason,
        "error": _by_joint(names, last.error) if last else {},
        "threshold": _by_joint(names, last.threshold) if last else {},
        "held_stamp_ns": change.held_stamp,
    }


def _by_joint(names: Sequence[str], values: Sequence[float]) -> dict[str, float | None]:
    """Return values by joint name; JSON has no word for what is no number."""
    return {name: value if math.isfinite(value) else None for name, value in zip(names, values)}


def _say(state: SyncState) -> Callable[..., None]:
    if state in _SERIOUS:
        return rospy.logerr
    return rospy.logwarn if state in _WARNED else rospy.loginfo
