"""The units in which an axis appears in telegrams: the only place besides a make's codec where degrees and millimetres appear."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class AxisUnit:
    """How one axis is written on the wire: ``feedback = feedback_scale * unit * (sign * x + offset)``.

    `unit` is deg per rad, or mm per m for a linear axis; the offset is the controller's [rad], [m]. A correction has no offset,
    and its own scale (docs/rsi.md, section 11).
    """

    linear: bool = False
    sign: int = 1
    offset: float = 0.0
    feedback_scale: float = 1.0
    correction_scale: float = 1.0

    @property
    def feedback_factor(self) -> float:
        """Wire units of a position per rad or m."""
        return self._per_unit * self.feedback_scale * self.sign

    @property
    def reading_factor(self) -> float:
        """Rad or m per wire unit of a position."""
        return self._inverse / self.feedback_scale * self.sign

    @property
    def zero(self) -> float:
        """What is subtracted from a position after `reading_factor` [rad] or [m]."""
        return self.sign * self.offset

    @property
    def correction_factor(self) -> float:
        """Wire units of a correction per rad or m."""
        return self._per_unit * self.correction_scale * self.sign

    @property
    def correction_reading_factor(self) -> float:
        """Rad or m per wire unit of a correction."""
        return self._inverse / self.correction_scale * self.sign

    @property
    def _per_unit(self) -> float:
        return 1e3 if self.linear else 180.0 / math.pi

    @property
    def _inverse(self) -> float:
        return 1e-3 if self.linear else math.pi / 180.0
