"""Under which addresses a browser opens the console: where it listens, or the names in its certificate. Standard library only."""

from __future__ import annotations

import ipaddress
import socket
import ssl
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import cast


def addresses(listen: str, port: int, certificate: Path | None, key: Path | None, scheme: str, path: str) -> list[str]:
    """Return the addresses, at least one.

    Args:
        listen: Name or address on which it listens. Of ``0.0.0.0`` and ``::``, which nothing can open, the certificate's names take
            the place; without any, this machine's.
        scheme, path: What stands before and behind.
    """
    hosts: Iterable[str] = [listen]
    if is_everywhere(listen):
        named = certificate_names(certificate, key) if certificate and key else []
        hosts = named or [socket.gethostname()]
    return [f"{scheme}://{f'[{host}]' if ':' in host else host}:{port}{path}" for host in hosts]


def is_everywhere(listen: str) -> bool:
    """Return whether a server on this address listens on all of them."""
    try:
        return ipaddress.ip_address(listen).is_unspecified
    except ValueError:
        return not listen


def certificate_names(certificate: Path, key: Path) -> list[str]:
    """Return the names and addresses that a server's certificate is for; none when no browser would accept it any more.

    The standard library tells them only of a certificate that it has verified, so a client and a server meet in memory.

    Args:
        certificate, key: In PEM.
    """
    own = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    own.load_cert_chain(certificate, key, password="")
    trust = ssl.create_default_context(cafile=str(certificate))
    trust.check_hostname = False
    # this one certificate, whoever has signed it
    trust.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN
    there, back = ssl.MemoryBIO(), ssl.MemoryBIO()
    client, server = trust.wrap_bio(back, there), own.wrap_bio(there, back, server_side=True)
    for side in (client, server, client):
        try:
            side.do_handshake()
        except ssl.SSLWantReadError:
            continue
        except ssl.SSLCertVerificationError:
            return []
    details = cast(Mapping[str, tuple[tuple[str, str], ...]], client.getpeercert() or {})
    found = details.get("subjectAltName", ())
    names = [value.strip() for kind, value in found if kind in ("DNS", "IP Address") and "*" not in value]
    return [str(ipaddress.ip_address(name)) if ":" in name else name for name in names]
