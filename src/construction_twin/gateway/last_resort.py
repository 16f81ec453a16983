"""What answers RSI after the gateway itself has failed: brakes from the last correction that was sent, then holds, and echoes IPOC.

It is small and is built at the start. From the code that may have failed it uses only the text of a reply, copied beforehand.
Pure. Standard library only; rad, m for linear axes.
"""

from __future__ import annotations

import math
import re

from construction_twin.core.limits import MotionLimits
from construction_twin.core.udp import MAX_TELEGRAM
from construction_twin.rsi.gateway_codec import SensorEncoder, ipoc_step

#: After a longer gap it is unknown whether the controller still has the correction: a program may have started RSI anew, and the
#: correction would be a jump. It is answered no more, and times out; the arm stands already [ms]. Ten cycles of 4 ms, three of 12.
LONGEST_GAP_MS = 40
_IPOC = re.compile(rb"<IPOC>\s*([0-9]{1,20})\s*</IPOC>").search
_DELAY = re.compile(rb"""<Delay\s+D\s*=\s*["']([0-9]{1,20})["']""").search
_LARGEST_IPOC = 2**64 - 1
#: What lies further behind, or further ahead past a wrap, is no telegram of the session [ms].
_LONGEST_STEP = 60_000


class LastResort:
    """Remembers what was sent; after `take_over` answers in the gateway's place.

    Args:
        encoder: Whose replies are copied; None: the controller expects no answers, and gets none.
        cycle_ms: The controller's cycle [ms].

    Attributes:
        ending: True: once at rest, replies carry Stop 1, which ends RSI_MOVECORR.
        correction: Shape (n,). Sent last; () before the first.
        ipoc: Answered last.
    """

    def __init__(self, limits: MotionLimits, encoder: SensorEncoder | None, cycle_ms: int = 4):
        self._cycle = cycle_ms
        self._budget = tuple(a * cycle_ms * cycle_ms * 1e-6 for a in limits.acceleration)
        self._order = encoder.order if encoder else ()
        self._texts = {stop: encoder.template(stop) for stop in (None, True)} if encoder else {}
        self._source: object = None
        # what the controller had before the last correction, and its count of late replies then
        self._kept: tuple[float, ...] = ()
        self._delay = 0
        self._step: tuple[float, ...] = ()
        self._over = encoder is None
        self.correction: tuple[float, ...] = ()
        self.ipoc = 0
        self.ending = False

    def sent(
        self, ipoc: int, source: object, correction: tuple[float, ...], kept: tuple[float, ...], delay: int | None
    ) -> None:
        """Take note of a reply that the gateway has sent.

        Args:
            ipoc: [ms]
            source: To whom.
            correction: Shape (n,). [rad], [m]
            kept: Shape (n,) or (). The correction that the controller had before, and keeps if this one does not arrive; () for
                none.
            delay: `Delay` of the telegram.
        """
        self.correction, self._kept, self.ipoc, self._source = correction, kept, ipoc, source
        self._delay = delay or 0

    def hold(self, holding: bytes, ending: bytes) -> None:
        """Take the texts of replies that leave a tool's outputs as they were sent last: with `Stop` 0, and with 1."""
        self._texts = {None: holding, True: ending}

    def take_over(self) -> None:
        """Begin to answer: with the last step that was commanded."""
        if len(self._kept) == len(self.correction):
            self._step = tuple([new - old for new, old in zip(self.correction, self._kept)])
        else:
            self._step = (0.0,) * len(self.correction)

    @property
    def at_rest(self) -> bool:
        """True when the correction changes no more."""
        return not any(self._step)

    @property
    def ends(self) -> bool:
        """True when replies carry Stop 1."""
        return self.ending and self.at_rest and not self._over and bool(self.correction)

    def ipoc_of(self, data: bytes, source: object) -> int | None:
        """Return the IPOC of a datagram to be answered; None when it is an old one, or not from the session's controller."""
        if self._over or source != self._source or len(data) > MAX_TELEGRAM:
            return None
        found = _IPOC(data)
        ipoc = int(found[1]) if found else -1
        return ipoc if 0 <= ipoc <= _LARGEST_IPOC and self.is_newer(ipoc, self.ipoc) else None

    @staticmethod
    def is_newer(ipoc: int, other: int) -> bool:
        """Return whether a telegram follows another one, by their IPOC [ms]."""
        return ipoc_step(other, ipoc, _LONGEST_STEP) > 0

    def note_delay(self, ipoc: int, data: bytes) -> bool:
        """Go back to what the controller has if a telegram says that the last reply did not arrive; return whether it does.

        Call it before `answer`, with the same telegram. `Delay` has risen by every cycle since the last one then.
        """
        found = _DELAY(data)
        if found is None:
            return False
        delay, before = int(found[1]), self._delay
        self._delay = delay
        cycles = max(1, ipoc_step(self.ipoc, ipoc, _LONGEST_STEP) // self._cycle)
        lost = delay - before >= cycles and len(self._kept) == len(self.correction)
        if lost:
            self.correction = self._kept
            self._step = (0.0,) * len(self._step)
        return lost

    def answer(self, ipoc: int) -> bytes | None:
        """Brake on by one step and return the reply to a telegram that `ipoc_of` found; None when the session is over."""
        elapsed = ipoc_step(self.ipoc, ipoc, _LONGEST_STEP)
        if elapsed > LONGEST_GAP_MS and any(self.correction):
            self._over = True
            return None
        if elapsed > self._cycle:
            self._step = (0.0,) * len(self._step)
        self._step = tuple([math.copysign(max(0.0, abs(v) - most), v) for v, most in zip(self._step, self._budget)])
        self._kept = self.correction
        self.correction = tuple([value + step for value, step in zip(self.correction, self._step)])
        self.ipoc = ipoc
        values = [self.correction[index] * factor for index, factor in self._order]
        text = self._texts[True if self.ends else None] % (*values, ipoc)
        return text.replace(b'"-0.000000"', b'"0.000000"')
