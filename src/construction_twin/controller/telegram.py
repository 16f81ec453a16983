"""Telegrams and replies of any robot controller as values in rad and m, the steps of its clock in ms, and the units of its wire."""

from __future__ import annotations

import math
from dataclasses import dataclass

#: A controller that counts its time in 32 bits goes on with 0 here (docs/rsi.md, section 4).
STAMP_WRAP = 2**32
#: A stamp counts milliseconds [ns].
STAMP_NS = 1_000_000


@dataclass(frozen=True, slots=True)
class Telegram:
    """One telegram of a controller.

    Attributes:
        controller_ms: Controller time, 0 to 2^64 - 1; see `stamp_step`.
        measured: Length n. None: unknown.
        setpoint: Length n. What the axes follow without corrections, or the absolute target that they follow; None: unknown.
        missed: The controller's count of cycles without a valid reply.
    """

    controller_ms: int
    measured: tuple[float, ...] | None
    setpoint: tuple[float, ...] | None
    missed: int | None


@dataclass(frozen=True, slots=True)
class Reply:
    """One reply to the telegram of a stamp, as a controller reads it.

    Attributes:
        target: Length n. Positions of the axes, or corrections to an origin (`Make.absolute`).
        stop: Whether it ends the controller's program; None: no such channel.
        switched: Channels of a tool, in the order of `Layout.switched`.
    """

    controller_ms: int
    target: tuple[float, ...]
    stop: bool | None
    switched: tuple[bool, ...] = ()


def stamp_step(before: int, stamp: int, longest: int) -> int:
    """Return how far a controller's clock is on from one telegram to another of the same session [ms]; negative: back.

    A count that wrapped at 2^32 is taken for a step only when it is no longer than `longest`, less than 2^31.
    """
    step = stamp - before
    if -longest <= step <= longest or before >= STAMP_WRAP or stamp >= STAMP_WRAP:
        return step
    wrapped = step + STAMP_WRAP if step < 0 else step - STAMP_WRAP
    return wrapped if -longest <= wrapped <= longest else step


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
