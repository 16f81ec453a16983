"""The error of an Ethernet XML. Standard library only."""

from __future__ import annotations

from construction_twin.core.errors import ConfigurationError


class EthernetXmlError(ConfigurationError):
    """An RSI Ethernet XML cannot be used.

    Attributes:
        element: Path or TAG of the element that does not fit, e.g. ``CONFIG/PORT`` or ``RECEIVE AK.A1 HOLDON``.
    """

    def __init__(self, where: str, element: str, value: object, expected: str):
        self.element = element
        super().__init__(f"{where}: {element}", value, expected)
