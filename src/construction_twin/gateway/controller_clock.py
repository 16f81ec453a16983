"""Measurement of the controller's clock by its telegrams: cycle, and rate against this machine's clock.

Motion is played, limited and braked per cycle, so a controller of another cycle must be named before it is commanded. Only medians
are judged: lost telegrams, stalls of either machine and jitter shift single steps and times, but not half of them. Stamps in ms,
times of arrival in ns.
"""

from __future__ import annotations

from collections import deque
from statistics import median

from construction_twin.controller.port import Make
from construction_twin.controller.telegram import STAMP_NS, stamp_step
from construction_twin.core.sentences import Sentence

#: A session is measured for this long before it is first judged [ms of it, at the expected cycle].
FIRST = 400
#: A clock that seems to run at another rate is judged only after so long [ms]: so does one on a machine that is just disturbed.
PATIENT = 4000
#: Distance of the two telegrams that a rate is taken from [ms]: long against the jitter, short against the time between two stalls.
BASE = 200
#: The rate may differ from 1 by this much: more than any clock's error, and ten times what the playout follows in motion.
TOLERANCE = 0.05
#: So many steps in a row of a longer cycle are no lost telegrams: with a third of all lost at random that takes decades.
LOSSES = 10
#: So many of the shorter one: no loss makes a step shorter than a cycle, and a telegram behind a newer one makes no step.
SHORTER = 3
#: Telegrams that the figures of the status are taken from.
SHOWN = 250


class ControllerClock:
    """Measures a controller's clock against the expected `cycle_ms`; `measures` False (a simulated clock): it stays idle."""

    def __init__(self, make: Make, cycle_ms: int, measures: bool = True):
        self.measures = measures
        self._cycle = cycle_ms
        self._modes, self._terms = make.cycles, make.terms
        self._first, self._patient, self._base = FIRST // cycle_ms, PATIENT // cycle_ms, BASE // cycle_ms
        # the stamp as it would be without a wrap, and arrival
        self._arrivals: deque[tuple[int, int]] = deque(maxlen=self._patient)
        # the last stamp as received
        self._stamp = 0
        self._others = {mode: LOSSES if mode > cycle_ms else SHORTER for mode in self._modes if mode != cycle_ms}
        self.restart()

    def restart(self) -> None:
        """Begin with another session."""
        self._arrivals.clear()
        self._to_judge = self._first
        #: The sentence that the last telegrams have another cycle of the make, until `judge` finds the expected one.
        self.changed = ""
        # the last step that was another cycle, where it led, and how many of it came in a row
        self._other = self._other_stamp = self._in_a_row = 0
        # the step that the last finding was about, 0 for one about the rate; None for no finding
        self._found: float | None = None

    def on_telegram(self, stamp: int, arrived: int) -> None:
        """Store stamp [ms] and arrival [ns] of a telegram, also of one that is not answered."""
        arrivals = self._arrivals
        if not self.measures:
            return
        if arrivals:
            step = stamp_step(self._stamp, stamp, PATIENT)
            if not 0 < step <= PATIENT:
                if -PATIENT <= step <= 0:
                    # came twice, or behind a newer one
                    return
                self.restart()
                self._stamp = stamp
            else:
                self._stamp, stamp = stamp, arrivals[-1][0] + step
                if step != self._cycle and step in self._others:
                    self._on_other_step(stamp, step)
        else:
            self._stamp = stamp
        arrivals.append((stamp, arrived))
        self._to_judge -= 1

    def _on_other_step(self, stamp: int, step: int) -> None:
        """Count a step of another cycle; enough in a row restart the measurement at the first of them."""
        follows = step == self._other and stamp - step == self._other_stamp
        self._in_a_row = self._in_a_row + 1 if follows else 1
        self._other, self._other_stamp = step, stamp
        if self.changed or self._in_a_row != self._others[step]:
            return
        self.changed = self._cycle_sentence(step)
        arrivals = self._arrivals
        while len(arrivals) > self._in_a_row:
            arrivals.popleft()
        self._to_judge = self._first - len(arrivals)

    def judge(self, rates: bool = True) -> str | None:
        """Return the clock's fault, "" for none; None: as before. Due every 0.4 s, when nothing waits.

        Without `rates` only the cycle is judged: a rate that once was right becomes wrong by a machine that stalls.
        """
        if self._to_judge > 0:
            return self._once(self._other, self.changed) if self.changed and not rates else None
        self._to_judge = self._first
        step, rate = self._figures(self._patient) if rates else (self._step(list(self._arrivals)), 1.0)
        if step != self._cycle:
            return self._once(step, self._cycle_sentence(step))
        self.changed = ""
        if abs(rate - 1.0) <= TOLERANCE:
            self._found = None
            return ""
        if len(self._arrivals) < self._patient:
            return None
        return self._once(
            0.0,
            Sentence(
                "the controller's clock runs {rate:.2f} times as fast as real time: what sends is no controller in real time",
                rate=rate,
            ),
        )

    def _once(self, found: float, sentence: str) -> str | None:
        before, self._found = self._found, found
        return sentence if before != found else None

    def status_fields(self) -> dict:
        """Return the fields of the status; None: not known yet."""
        step = rate = None
        if len(self._arrivals) > self._base:
            step, rate = self._figures(SHOWN)
        return {
            "expected_ms": self._cycle,
            "ipoc_step_ms": step,
            "telegram_ms": round(step / rate, 3) if step and rate else None,
            "rate": None if rate is None else round(rate, 4),
        }

    def _figures(self, count: int) -> tuple[float, float]:
        """Return the step of the stamps [ms] and the rate of the clock, from the last `count` telegrams."""
        arrivals = list(self._arrivals)[-count:]
        pace = median(
            [
                (later[1] - earlier[1]) / (later[0] - earlier[0])
                for earlier, later in zip(arrivals, arrivals[self._base :])
            ]
        )
        return self._step(arrivals), STAMP_NS / pace if pace > 0.0 else 0.0

    @staticmethod
    def _step(arrivals: list[tuple[int, int]]) -> float:
        return median([later[0] - earlier[0] for earlier, later in zip(arrivals, arrivals[1:])])

    def _cycle_sentence(self, step: float) -> Sentence:
        return Sentence(
            "the controller's cycle is {step:g} ms ({stamp} steps of {step:g}); expected {expected} ms: {setting}",
            step=step,
            stamp=self._terms.stamp,
            expected=self._cycle,
            setting=self._terms.cycle.format(self._modes[self._cycle]),
        )
