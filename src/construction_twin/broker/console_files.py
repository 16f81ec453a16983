"""What a site's console needs: its certificate, and its addresses as links and QR codes.

No password stands in any of them: who scans a code still logs in.

QR codes need the Python package `segno`; without it the addresses are written all the same, and what is missing is said.
"""

from __future__ import annotations

import importlib.util
import io
import json
from collections.abc import Iterable
from pathlib import Path

from construction_twin.broker.access import Site, people_of
from construction_twin.broker.certificates import Authority, make_folder, write_private

_NAME = "construction_twin console"
#: Size of a module of a QR code in SVG units, or pixels.
_SCALE = 8


class ConsoleFiles:
    """The folder `console/` of a site: `console.crt`, `console.key`, `ca.crt`, `rights.json`, `addresses.txt`, their QR codes."""

    def __init__(self, folder: Path):
        self._folder = folder
        self.certificate = folder / "console.crt"

    def make(self, site: Site, before: Iterable[str], authority: Authority, days: int, renew: bool) -> list[str]:
        """Make what is missing; return sentences on what was done.

        Args:
            before: Names of the console in the last run: for others its certificate is signed anew.
            days: Lifetime of a new certificate.
            renew: Sign it anew in any case, for the same key.

        Raises:
            ConstructionTwinError: When openssl is missing or a name does not fit.
        """
        if not site.consoles:
            return []
        lines = []
        make_folder(self._folder)
        if renew or tuple(before) != site.consoles or not self.certificate.exists():
            authority.issue(_NAME, self._folder / "console.key", self.certificate, days, site.consoles)
            lines.append(f"signed the console's certificate for {', '.join(site.consoles)}")
        write_private(self._folder / "ca.crt", authority.certificate.read_text(encoding="utf-8"))
        write_private(self._folder / "rights.json", json.dumps({"robots": people_of(site)}, indent=1) + "\n")
        addresses = site.console_addresses()
        write_private(self._folder / "addresses.txt", "".join(f"{address}\n" for address in addresses))
        return lines + self._make_codes(site.consoles, addresses)

    def _make_codes(self, hosts: Iterable[str], addresses: Iterable[str]) -> list[str]:
        if importlib.util.find_spec("segno") is None:
            return [
                "no QR codes of the console's addresses: the Python package segno is not installed; run setup/setup.sh console, "
                f"then this again; the addresses are in {self._folder / 'addresses.txt'}"
            ]
        lines = []
        for host, address in zip(hosts, addresses):
            paths = [self._folder / f"{host.replace(':', '_')}.{kind}" for kind in ("svg", "png")]
            codes = [picture(address, path.suffix[1:]) for path in paths]
            if all(path.exists() and path.read_bytes() == code for path, code in zip(paths, codes)):
                continue
            for path, code in zip(paths, codes):
                write_private(path, code)
            lines.append(f"made a QR code of {address}: {paths[0]}, {paths[1].name}; it holds the address, no password")
        return lines


def picture(address: str, kind: str) -> bytes:
    """Return a QR code as a picture; `segno` must be there.

    Args:
        kind: ``svg`` or ``png``.
    """
    import segno

    buffer = io.BytesIO()
    segno.make(address, micro=False).save(buffer, kind=kind, scale=_SCALE, light="white")
    return buffer.getvalue()


def in_characters(address: str) -> str:
    """Return a QR code for a terminal; `segno` must be there."""
    import segno

    text = io.StringIO()
    segno.make(address, micro=False).terminal(text, compact=True)
    return text.getvalue()
