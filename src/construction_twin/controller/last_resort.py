"""Replies after a failure of the gateway: braking from the last target sent, then rest. rad, m.

It is built at the start, and uses of the code that may have failed only the text of a reply, copied beforehand.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from construction_twin.controller.telegram import stamp_step
from construction_twin.core.limits import MotionLimits
from construction_twin.core.network import MAX_TELEGRAM

#: After a longer gap a program may have started a session anew, and the target would be a jump: it is answered no more [ms].
LONGEST_GAP_MS = 40
_LARGEST_STAMP = 2**64 - 1
#: What lies further behind, or further ahead past a wrap, is no telegram of the session [ms].
_LONGEST_STEP = 60_000


@dataclass(frozen=True)
class BareProtocol:
    """The last resort's view of a make.

    Attributes:
        stamp, missed: A datagram's stamp [ms], its count of cycles without a valid reply; None without one.
        write: The reply to a stamp, from the text of a reply and the target.
        texts: Texts of replies that leave the controller's program running, and that end it.
    """

    stamp: Callable[[bytes], int | None]
    missed: Callable[[bytes], int | None]
    write: Callable[[bytes, tuple[float, ...], int], bytes]
    texts: tuple[bytes, bytes]


class LastResort:
    """Stores the replies sent; after `begin` answers in the gateway's place.

    `target` and `stamp` are those of the last reply; `ending`: once at rest, replies end the controller's program.
    """

    def __init__(self, limits: MotionLimits, bare: BareProtocol | None, cycle_ms: int):
        self._cycle = cycle_ms
        self._budget = tuple(a * cycle_ms * cycle_ms * 1e-6 for a in limits.acceleration)
        self._bare = bare
        self._texts = bare.texts if bare else (b"", b"")
        self._source: object = None
        # what the controller had before the last target, and its count of missed replies then
        self._last_acknowledged: tuple[float, ...] = ()
        self._missed = 0
        self._step: tuple[float, ...] = ()
        self._over = bare is None
        self.target: tuple[float, ...] = ()
        self.stamp = 0
        self.ending = False

    def on_reply_sent(
        self,
        stamp: int,
        source: object,
        target: tuple[float, ...],
        acknowledged: tuple[float, ...],
        missed: int | None,
    ) -> None:
        """Store a reply; `acknowledged`: the target that the controller keeps if it is lost."""
        self.target, self._last_acknowledged, self.stamp, self._source = target, acknowledged, stamp, source
        self._missed = missed or 0

    def set_templates(self, holding: bytes, ending: bytes) -> None:
        """Store reply templates with the tool's outputs as sent last, without and with the end of the program."""
        self._texts = holding, ending

    def begin(self) -> None:
        """Begin braking from the last commanded step."""
        if len(self._last_acknowledged) == len(self.target):
            self._step = tuple([new - old for new, old in zip(self.target, self._last_acknowledged)])
        else:
            self._step = (0.0,) * len(self.target)

    @property
    def at_rest(self) -> bool:
        """Whether the target is constant."""
        return not any(self._step)

    @property
    def ends_program(self) -> bool:
        """True when replies end the program."""
        return self.ending and self.at_rest and not self._over and bool(self.target)

    def stamp_of(self, data: bytes, source: object) -> int | None:
        """Return the stamp of a datagram to be answered; None: an old one, or another source."""
        if self._over or self._bare is None or source != self._source or len(data) > MAX_TELEGRAM:
            return None
        stamp = self._bare.stamp(data)
        return stamp if stamp is not None and stamp <= _LARGEST_STAMP and self.is_newer(stamp, self.stamp) else None

    @staticmethod
    def is_newer(stamp: int, other: int) -> bool:
        """Return whether a telegram follows another one, by their stamps [ms]."""
        return stamp_step(other, stamp, _LONGEST_STEP) > 0

    def rewind_if_lost(self, stamp: int, data: bytes) -> bool:
        """Return to the acknowledged target if a telegram reports a lost reply; return whether it did."""
        missed = self._bare.missed(data) if self._bare is not None else None
        if missed is None:
            return False
        before, self._missed = self._missed, missed
        cycles = max(1, stamp_step(self.stamp, stamp, _LONGEST_STEP) // self._cycle)
        lost = missed - before >= cycles and len(self._last_acknowledged) == len(self.target)
        if lost:
            self.target = self._last_acknowledged
            self._step = (0.0,) * len(self._step)
        return lost

    def answer(self, stamp: int) -> bytes | None:
        """Brake by one step and return the reply; None when the session is over."""
        elapsed = stamp_step(self.stamp, stamp, _LONGEST_STEP)
        if self._bare is None or (elapsed > LONGEST_GAP_MS and any(self.target)):
            self._over = True
            return None
        if elapsed > self._cycle:
            self._step = (0.0,) * len(self._step)
        self._step = tuple([math.copysign(max(0.0, abs(v) - most), v) for v, most in zip(self._step, self._budget)])
        self._last_acknowledged = self.target
        self.target = tuple([value + step for value, step in zip(self.target, self._step)])
        self.stamp = stamp
        return self._bare.write(self._texts[self.ends_program], self.target, stamp)
