"""`twin pair`: invites a tablet with a QR code, lists those that are paired, and takes them away. Needs no ROS master.

Run it where the console runs, as its user: both work on one folder. Nothing else of the site is changed.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from construction_twin.broker.access import Site
from construction_twin.broker.certificates import write_private
from construction_twin.broker.console_files import in_characters, picture
from construction_twin.broker.make_site import SiteFolder
from construction_twin.core.errors import ConfigurationError, ConstructionTwinError, RequestRefused
from construction_twin.core.sentences import Sentence
from construction_twin.views.arguments import Exit

if TYPE_CHECKING:
    from construction_twin.console.pairings import Device, Pairings

#: So often it is looked whether a code was used [s].
_LOOK_S = 0.5
_NEEDED = ("cryptography", "segno")


class PairCommand:
    """One call of `twin pair`.

    Args:
        options: As `views.arguments.parser` makes them.
        sleep: Waits so many seconds.
    """

    def __init__(self, options: argparse.Namespace, sleep: Callable[[float], None] = time.sleep):
        self._options, self._sleep = options, sleep

    def run(self) -> Exit:
        """Do it.

        Raises:
            ConstructionTwinError: Saying what is missing, or refused.
        """
        options = self._options
        for package in _NEEDED:
            if importlib.util.find_spec(package) is None:
                raise ConstructionTwinError(Sentence("view.pair.no_package", package=package))
        from construction_twin.console.pairings import Pairings

        pairings = Pairings(Path(options.pairings or Path(options.site, "console/pairings")), time.time)
        if options.list:
            return self._list(pairings)
        if options.revoke:
            return self._revoke(pairings)
        return self._invite(pairings)

    def _list(self, pairings: Pairings) -> Exit:
        devices = pairings.devices(self._options.person)
        print("\n".join(map(device_line, devices)) or "no device is paired")
        for sentence in pairings.unreadable():
            print(f"twin: {sentence}", file=sys.stderr)
        return Exit.DONE

    def _revoke(self, pairings: Pairings) -> Exit:
        options = self._options
        gone = pairings.revoke(options.revoke, options.device)
        for each in gone:
            print(f"revoked: {device_line(each)}")
        if not gone and options.device is not None:
            raise RequestRefused(Sentence("view.pair.no_device", person=options.revoke, number=options.device))
        if not gone:
            print(f"no device of {options.revoke} is paired; codes that were not used yet are void")
        return Exit.DONE

    def _invite(self, pairings: Pairings) -> Exit:
        from construction_twin.console.pairings import INVITED_S, Person, hash_of

        options, folder = self._options, SiteFolder(Path(self._options.site))
        site = folder.site()
        account, device_account = _accounts(site, options.person)
        address = _address(site, options.console)
        passwords = folder.password(account), folder.password(device_account)
        file = Path(options.picture) if options.picture else None
        if file is not None and file.suffix.lower() not in (".svg", ".png"):
            raise ConfigurationError("--picture", str(file), Sentence("expected.one_of", known=".svg, .png"))
        token = pairings.invite(Person(account, device_account), *passwords)
        hashed, is_left = hash_of(token), False
        try:
            with _shown(f"{address}#pair={token}", file, not options.no_wait):
                print(
                    f"a tablet that scans this within {INVITED_S / 60:g} minutes, first and once, becomes {account}'s"
                )
                sys.stdout.flush()
                is_left = options.no_wait
                while not is_left and pairings.is_invited(hashed):
                    self._sleep(_LOOK_S)
        finally:
            # whoever does not wait for it any more does not want it used
            if not is_left:
                pairings.withdraw(hashed)
        if is_left:
            return Exit.DONE
        device = pairings.paired_with(hashed)
        if device is None:
            raise RequestRefused(Sentence("view.pair.unused", person=account))
        print(f"paired: {device_line(device)}. If this is another tablet than yours: twin pair --revoke {account}")
        return Exit.DONE


def _accounts(site: Site, name: str) -> tuple[str, str]:
    for person in site.persons:
        if person.name == name:
            return person.name, person.device_account
    known = ", ".join(person.name for person in site.persons)
    raise ConfigurationError("twin pair", name, Sentence("expected.pairings.person", known=known))


def _address(site: Site, host: str) -> str:
    if not site.consoles:
        raise ConstructionTwinError(Sentence("view.pair.no_console"))
    if host and host not in site.consoles:
        raise ConfigurationError("--console", host, Sentence("expected.one_of", known=", ".join(site.consoles)))
    return site.console_addresses()[site.consoles.index(host) if host else 0]


@contextmanager
def _shown(address: str, file: Path | None, is_taken_away: bool) -> Iterator[None]:
    """Show a QR code in the terminal, and in a file, which is taken away with the code."""
    print(f"{in_characters(address)}{address}")
    if file is not None:
        write_private(file, picture(address, file.suffix.lower().removeprefix(".")))
    sys.stdout.flush()
    try:
        yield
    finally:
        if file is not None and is_taken_away:
            file.unlink(missing_ok=True)


def device_line(device: Device) -> str:
    """Return what is said of a device."""
    parts = [f"device {device.number} of {device.account}, paired {_when(device.paired)} from {device.address}"]
    parts.append(f"PIN last used {_when(device.used)}" if device.used else "PIN not used yet")
    if not device.has_pin:
        parts.append("no PIN any more, after too many wrong ones: it sees and stops only")
    elif device.wrong:
        parts.append(f"wrong PINs since: {device.wrong}")
    return "; ".join(parts)


def _when(stamp: float) -> str:
    return datetime.fromtimestamp(stamp).astimezone().strftime("%Y-%m-%d %H:%M")
