"""What the controller was answered last, and what it keeps where that did not arrive. Standard library only; rad."""

from __future__ import annotations


class Replies:
    """The answers to one controller, as far as the next one depends on them.

    They carry corrections to an origin, or `absolute` positions of the axes; with `zero` no correction, whatever is computed.
    """

    def __init__(self, absolute: bool, zero: bool):
        self._absolute, self._zero = absolute, zero
        # an answer carries the correction as it is
        self._plain = not absolute and not zero
        self.begin()

    def begin(self) -> None:
        """Forget the session before."""
        #: The last correction, as it would be without commissioning mode [rad]; () before the first.
        self.correction: tuple[float, ...] = ()
        #: What the last answer carried as a correction, if it was a computed one [rad]; () for nothing.
        self.sent: tuple[float, ...] = ()
        #: The one that the controller had before it, and keeps if it does not arrive [rad]; () before the first.
        self.kept: tuple[float, ...] = ()
        #: How long no answer has arrived while telegrams went on [ns].
        self.lost_for = 0

    def note(self, lost: bool, elapsed: int) -> None:
        """Take note of whether the last answer was lost, `elapsed` [ns] of the controller's time ago."""
        if lost:
            self.lost_for += elapsed
        else:
            self.kept, self.lost_for = self.correction, 0

    def answer(self, position: tuple[float, ...], origin: tuple[float, ...]) -> tuple[float, ...]:
        """Return what the answer carries that is to bring the axes to a position [rad]."""
        correction = tuple([value - start for value, start in zip(position, origin)])
        self.correction = correction
        if not self._zero:
            self.sent = correction
        return correction if self._plain else self.carried(correction, origin)

    def carried(self, correction: tuple[float, ...], origin: tuple[float, ...]) -> tuple[float, ...]:
        """Return what an answer carries for a correction [rad]."""
        if self._zero:
            correction = (0.0,) * len(correction)
        return moved(origin, correction) if self._absolute else correction


def moved(origin: tuple[float, ...], correction: tuple[float, ...]) -> tuple[float, ...]:
    """Return where a correction to an origin is [rad]."""
    return tuple([start + value for start, value in zip(origin, correction)])
