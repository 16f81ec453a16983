"""What answers RSI after the gateway itself has failed: brakes from the last correction that was sent, then holds, and echoes IPOC.

It is small and is built at the start. From the code that may have failed it uses only the text of a reply, copied beforehand.
Pure. Standard library only; rad, m for linear axes.
"""

from __future__ import annotations

import math
import re

from construction_twin.core.limits import MotionLimits
from construction_twin.rsi.gateway_codec import SensorEncoder, ipoc_step
from construction_twin.rsi.telegram import MAX_TELEGRAM

#: After a step of IPOC beyond this the arm has come to a stand under HOLDON [cycles].
STANDSTILL = 2
#: After a longer gap it is unknown whether the controller still has the correction: a program may have started RSI anew, and the
#: correction would be a jump. It is answered no more, and times out; the arm stands already [ms]. Ten cycles of 4 ms, three of 12.
LONGEST_GAP_MS = 40
_IPOC = re.compile(rb"<IPOC>\s*([0-9]{1,20})\s*</IPOC>").search
_LARGEST_IPOC = 2**64 - 1
#: What lies further behind, or further ahead past a wrap, is no telegram of the session [ms].
_LONGEST_STEP = 60_000


class LastResort:
    """Remembers what was sent; after `take_over` answers in the gateway's place.

    Parameters
    ----------
    limits : MotionLimits
    encoder : SensorEncoder or None
        Whose replies are copied; None: the controller expects no answers, and gets none.
    cycle_ms : int, optional
        The controller's cycle [ms].

    Attributes
    ----------
    ending : bool
        True: once at rest, replies carry Stop 1, which ends RSI_MOVECORR.
    correction : tuple of float, shape (n,)
        Sent last; () before the first.
    ipoc : int
        Answered last.
    """

    def __init__(self, limits: MotionLimits, encoder: SensorEncoder | None, cycle_ms: int = 4):
        self._standstill = STANDSTILL * cycle_ms
        self._budget = tuple(a * cycle_ms * cycle_ms * 1e-6 for a in limits.acceleration)
        self._order = encoder.order if encoder else ()
        self._texts = {stop: encoder.template(stop) for stop in (None, True)} if encoder else {}
        self._source: object = None
        self._before: tuple[float, ...] = ()
        self._before_ipoc = 0
        self._step: tuple[float, ...] = ()
        self._over = encoder is None
        self.correction: tuple[float, ...] = ()
        self.ipoc = 0
        self.ending = False

    def sent(self, ipoc: int, source: object, correction: tuple[float, ...]) -> None:
        """Take note of a reply that the gateway has sent: IPOC, to whom, correction [rad]."""
        self._before, self._before_ipoc = self.correction, self.ipoc
        self.correction, self.ipoc, self._source = correction, ipoc, source

    def hold(self, holding: bytes, ending: bytes) -> None:
        """Take the texts of replies that leave a tool's outputs as they were sent last: with `Stop` 0, and with 1."""
        self._texts = {None: holding, True: ending}

    def take_over(self) -> None:
        """Begin to answer: with the step between the last two corrections, if they followed one another."""
        step = ipoc_step(self._before_ipoc, self.ipoc, _LONGEST_STEP)
        if 0 < step <= self._standstill and len(self._before) == len(self.correction):
            self._step = tuple([new - old for new, old in zip(self.correction, self._before)])
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
        """Return the IPOC of a datagram that is to be answered; None when it is not from the session's controller, or an old one."""
        if self._over or source != self._source or len(data) > MAX_TELEGRAM:
            return None
        found = _IPOC(data)
        ipoc = int(found[1]) if found else -1
        return ipoc if 0 <= ipoc <= _LARGEST_IPOC and self.is_newer(ipoc, self.ipoc) else None

    @staticmethod
    def is_newer(ipoc: int, other: int) -> bool:
        """Return whether a telegram follows another one, by their IPOC [ms]."""
        return ipoc_step(other, ipoc, _LONGEST_STEP) > 0

    def answer(self, ipoc: int) -> bytes | None:
        """Brake on by one step and return the reply to a telegram that `ipoc_of` found; None when the session is over."""
        elapsed = ipoc_step(self.ipoc, ipoc, _LONGEST_STEP)
        if elapsed > LONGEST_GAP_MS and any(self.correction):
            self._over = True
            return None
        if elapsed > self._standstill:
            self._step = (0.0,) * len(self._step)
        self._step = tuple([math.copysign(max(0.0, abs(v) - most), v) for v, most in zip(self._step, self._budget)])
        self.correction = tuple([value + step for value, step in zip(self.correction, self._step)])
        self.ipoc = ipoc
        values = [self.correction[index] * factor for index, factor in self._order]
        text = self._texts[True if self.ends else None] % (*values, ipoc)
        return text.replace(b'"-0.000000"', b'"0.000000"')
