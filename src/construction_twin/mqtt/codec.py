"""The paper's joint string (Figure 6) and nothing else: rad inside, degrees on the wire.

One string is ``+012.345,-090.000,...``: per joint a sign, three digits, a point and a fixed number of decimals, comma
separated, so that a PLC can cut it by position. What does not fit is refused, never guessed. Standard library only.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from construction_twin.errors import ConfigurationError, PayloadError
from construction_twin.units import degrees, radians


class JointStringCodec:
    """Encodes and decodes joint strings of one length and one number of decimals.

    Parameters
    ----------
    joints : int
        Number of joints.
    decimals : int
        Decimals of a degree, 1 to 6. The paper's are 3.
    mapping : sequence of (int, float), optional
        Sign and offset [rad] per joint: the wire carries the controller's axis angle ``sign * q + offset``. Without it joint and
        axis angles are the same, as they are on the KUKA, and always on the gateway's side.

    Raises
    ------
    ConfigurationError
        If `decimals` or `joints` is out of range.

    References
    ----------
    Liang et al., section 3.3 and Figure 6.
    """

    def __init__(self, joints: int, decimals: int = 3, mapping: Sequence[tuple[int, float]] | None = None):
        if not 1 <= decimals <= 6:
            raise ConfigurationError("decimals", decimals, "1 to 6 decimals of a degree")
        if joints < 1:
            raise ConfigurationError("joints", joints, "at least one joint")
        self.joints = joints
        self._mapping = mapping if mapping and any(entry != (1, 0.0) for entry in mapping) else None
        self.decimals = decimals
        width = 5 + decimals
        self.length = joints * width + joints - 1
        self._template = ",".join([f"%+0{width}.{decimals}f"] * joints)
        self._zero = f"+000.{'0' * decimals}"
        self._pattern = re.compile(rb",".join([rb"([+-]\d{3}\.\d{%d})" % decimals] * joints))

    @classmethod
    def of(cls, robot, decimals: int) -> JointStringCodec:
        """Return the codec for a `RobotModel`'s joints."""
        return cls(len(robot.joint_names), decimals, [(axis.sign, axis.offset) for axis in robot.axes])

    def encode(self, q: tuple[float, ...]) -> bytes:
        """Return the joint string of a pose.

        Parameters
        ----------
        q : tuple, shape (joints,)
            Joint angles [rad], A1 first.

        Returns
        -------
        payload : bytes
            ASCII; zero is always ``+000.000``, rounding is half-even on the exact value.

        Raises
        ------
        PayloadError
            ``count``, ``values`` (nan, inf) or ``range`` (1000 degrees or more after rounding).
        """
        if len(q) != self.joints:
            raise PayloadError("count", f"{len(q)} joint values; expected {self.joints}")
        if not all(map(math.isfinite, q)):
            raise PayloadError("values", f"joint values {tuple(q)} are not all finite numbers")
        if self._mapping:
            q = [sign * value + offset for value, (sign, offset) in zip(q, self._mapping)]
        text = self._template % degrees(q)
        # a huge angle in rad is infinite in degrees, and "+0000inf" would have the right length
        if len(text) != self.length or "inf" in text:
            raise PayloadError("range", f"{text!r} does not fit the format: a joint is at or beyond 1000 degrees")
        return text.replace("-" + self._zero[1:], self._zero).encode("ascii")

    def decode(self, payload: bytes) -> tuple[float, ...]:
        """Return the pose that a joint string stands for.

        Parameters
        ----------
        payload : bytes

        Returns
        -------
        q : tuple, shape (joints,)
            Joint angles [rad].

        Raises
        ------
        PayloadError
            ``decimals`` when the string is well formed with another number of decimals, ``length`` or ``format``.
        """
        match = self._pattern.fullmatch(payload) if len(payload) == self.length else None
        if match is None:
            raise self._why(payload)
        axes = radians(map(float, match.groups()))
        if self._mapping:
            return tuple([sign * (value - offset) for value, (sign, offset) in zip(axes, self._mapping)])
        return axes

    def quantise(self, q: tuple[float, ...]) -> tuple[float, ...]:
        """Return `q` as the receiver of its joint string will see it [rad]; idempotent."""
        return self.decode(self.encode(q))

    def _why(self, payload: bytes) -> PayloadError:
        shown = payload[:80]
        other = re.fullmatch(rb"[+-]\d{3}\.(\d+)(?:,[+-]\d{3}\.\d+){%d}" % (self.joints - 1), payload[:512])
        if other and len(other.group(1)) != self.decimals:
            return PayloadError(
                "decimals",
                f"joint string with {len(other.group(1))} decimals; this side is configured for {self.decimals}: "
                "give both sides the same number",
            )
        if len(payload) != self.length:
            return PayloadError("length", f"{len(payload)} bytes {shown!r}; expected {self.length}")
        return PayloadError(
            "format", f"{shown!r} is not {self.joints} times a sign, 3 digits, a point, {self.decimals} digits"
        )
