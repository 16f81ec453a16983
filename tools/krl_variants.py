"""The sets of files in krl/, and the numbers that all of them use."""

from __future__ import annotations

from dataclasses import dataclass

TIMEOUT, FLAG, PRECISION = 100, 1, 6
#: Length of each axis' range [deg]: a correction can never be larger, wherever the session starts. KR 120 R2500 pro.
SPAN = {"A1": 370, "A2": 135, "A3": 275, "A4": 700, "A5": 250, "A6": 700}
#: Placeholder for a track [mm]: longer than any.
TRACK = 30000


@dataclass(frozen=True)
class Variant:
    """One set of files: its name, whether it moves E1, whether it only listens."""

    name: str
    external: bool = False
    read_only: bool = False

    @property
    def ethernet(self) -> str:
        """Name of the Ethernet XML."""
        return f"{self.name}_ethernet.xml"

    @property
    def channels(self) -> list[tuple[str, str, int, int]]:
        """RECEIVE: TAG, TYPE, INDX, HOLDON."""
        if self.read_only:
            return []
        axes = [(f"AK.A{i}", "DOUBLE", i + 1, 1) for i in range(1, 7)]
        return [("Stop", "BOOL", 1, 0), *axes, *([("EK.E1", "DOUBLE", 8, 1)] if self.external else [])]


VARIANTS = (Variant("ctwin"), Variant("ctwin_e1", external=True), Variant("ctwin_ro", read_only=True))
