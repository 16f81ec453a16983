"""What a site's console needs: its certificate, and who has which right. No password stands in any of them."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

from construction_twin.broker.access import Site, people_of
from construction_twin.broker.certificates import Authority, make_folder, write_private

_NAME = "construction_twin console"


class ConsoleFiles:
    """The folder `console/` of a site: `console.crt`, `console.key`, `ca.crt`, `rights.json`."""

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
        return lines
