"""What an address says of where it is. Standard library only."""

from __future__ import annotations

import ipaddress


def is_loopback(host: str) -> bool:
    """Return whether a host is this machine itself and reached from nowhere else; of a name only ``localhost`` is known to be.

    Parameters
    ----------
    host : str
        Address or name.
    """
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
