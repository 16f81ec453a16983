"""What the arrivals of commands tell about the link: how late the latest come, and how the two clocks drift apart.

Pure and cheap per cycle: extremes per second, combined over a window. Standard library only; ns.
"""

from __future__ import annotations

from collections import deque

from construction_twin.core.units import NANOSECONDS

#: Length of the pieces whose extremes are kept [ns].
PIECE = NANOSECONDS
#: Pieces that count for the jitter: what is not seen again for 20 s is forgotten.
JITTER_PIECES = 20
#: Pieces that count for the drift, and how many of them it takes.
DRIFT_PIECES = 60
DRIFT_MINIMUM = 10
_FAR = 1 << 63


class Arrivals:
    """Observes how far the newest command is ahead of the controller's clock, as every telegram finds it.

    This is the difference of two clocks, so only its changes mean anything. At its largest value a command travelled fastest; at
    its smallest one came late, after a stall or after lost ones. The end of a stream is not lateness: the smallest value counts
    only once a command follows.
    """

    def __init__(self, assumed: int) -> None:
        #: Jitter to assume for the window's length: at first that of the configuration, then that of the stream before [ns].
        self.learned = assumed
        self.restart()

    def restart(self) -> None:
        """Begin with another stream; what was seen of the link counts for another window."""
        self._highs: deque[int] = deque(maxlen=JITTER_PIECES)
        self._lows: deque[int] = deque(maxlen=JITTER_PIECES)
        self._offsets: deque[tuple[int, int]] = deque(maxlen=DRIFT_PIECES)
        self._piece_ends = PIECE
        self._quickest: int | None = None
        self._started = self._changed = False
        self.high = self.low = 0
        self._high = self._low = 0

    @property
    def jitter(self) -> int:
        """The jitter to reckon with [ns]."""
        return max(self.observed, self.learned)

    @property
    def observed(self) -> int:
        """How much later than the quickest the latest command of the window came [ns]."""
        return self.high - self.low

    def remember(self) -> None:
        """Keep the jitter for the next stream."""
        self.learned = self.jitter

    def learn(self, jitter: int) -> None:
        """Take a jitter [ns] that was seen by other means."""
        if jitter > self.learned:
            self.learned, self._changed = jitter, True

    def note_telegram(self, lead: int, clock: int) -> bool:
        """Take how far the newest command is ahead of the clock at a telegram; return whether the extremes have changed since.

        The clock is the controller's, 0 at the stream's first command [ns].
        """
        if not self._started:
            self._started = True
            self.high = self.low = self._high = self._low = lead
            return True
        if lead > self._high:
            self._high = lead
            if lead > self.high:
                self.high, self._changed = lead, True
        if clock >= self._piece_ends:
            self._close_piece(clock)
        changed, self._changed = self._changed, False
        return changed

    def note_command(self, lead: int, offset: int) -> None:
        """Take a command's arrival [ns].

        Args:
            lead: Stamp of the command before it, minus the controller's clock at the last telegram: how far what was there reached.
            offset: Its own stamp minus the controller's clock, the latter interpolated to its arrival.
        """
        if self._quickest is None or offset > self._quickest:
            self._quickest = offset
        if self._started and lead < self._low:
            self._low = lead
            if lead < self.low:
                self.low, self._changed = lead, True

    def drift_ppm(self) -> float | None:
        """Return by how much the sender's clock is faster than the controller's; None before it can be told.

        The slope of a line through the quickest arrivals of each second, by least squares.
        """
        count = len(self._offsets)
        if count < DRIFT_MINIMUM:
            return None
        mean_time = sum(time for time, _ in self._offsets) / count
        mean_offset = sum(offset for _, offset in self._offsets) / count
        covariance = sum((time - mean_time) * (offset - mean_offset) for time, offset in self._offsets)
        return 1e6 * covariance / sum((time - mean_time) ** 2 for time, _ in self._offsets)

    def _close_piece(self, clock: int) -> None:
        self._highs.append(self._high)
        self._lows.append(self._low)
        if len(self._highs) == JITTER_PIECES:
            self.learned = 0
        if self._quickest is not None:
            self._offsets.append((clock, self._quickest))
        self._quickest = None
        self._piece_ends = clock + PIECE
        self.high, self.low = max(self._highs), min(self._lows)
        # worse than anything: the next telegram and the next command set them
        self._high, self._low = -_FAR, _FAR
        self._changed = True
