"""make_site: one command that makes a broker's certificates, accounts and access rules for a site. Needs no ROS.

What exists is kept: a second run adds robots, people and names, and replaces nothing that it is not asked to replace.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import re
import secrets
import tempfile
from collections.abc import Iterable
from pathlib import Path

from construction_twin.broker.access import RIGHTS, Site, access_rules, broker_configuration, merged, read_person
from construction_twin.broker.certificates import Authority, expiry, make_folder, run_tool, write_private
from construction_twin.core.errors import ConfigurationError, ConstructionTwinError, command_message
from construction_twin.core.share import share_file

#: Lifetime of certificates [days]: what most software accepts at most.
DAYS = 825
#: What follows when the CA's certificate is signed anew.
_NEEDED = "every tablet and every client needs the new ca.crt"


class SiteFolder:
    """The files of a site: `ca/`, `broker/`, `console/`, `accounts/<name>/`, `site.json`."""

    def __init__(self, folder: Path):
        self._folder, self._broker, self._console = folder, folder / "broker", folder / "console"
        self._settings = folder / "site.json"

    def load(self) -> dict:
        """Return the settings of the last run, empty before the first one; ConstructionTwinError when they cannot be read."""
        if not self._settings.exists():
            return {}
        try:
            document = json.loads(self._settings.read_text(encoding="utf-8"))
            if unknown := {*document} - {field.name for field in dataclasses.fields(Site)}:
                raise ValueError(f"it holds {sorted(unknown)}, which no site has")
            return {key: tuple(value) if isinstance(value, list) else value for key, value in document.items()}
        except (OSError, ValueError, TypeError, AttributeError) as error:
            raise ConstructionTwinError(f"{self._settings} cannot be read: {error}; restore it") from error

    def create_missing(
        self, site: Site, days: int = DAYS, renew: bool = False, replace: Iterable[str] = (), renew_ca: bool = False
    ) -> list[str]:
        """Make what is missing; return sentences on what was done. ConstructionTwinError, e.g. when the CA may not vouch for one.

        Args:
            days: Lifetime of new certificates.
            renew, renew_ca: Sign all certificates, or the CA's for the names of this site, anew for the same keys.
            replace: Accounts that get a new password and a new key.
        """
        replace, before = set(replace), self.load()
        if unknown := replace - {*site.accounts()}:
            raise ConfigurationError(
                "--replace", sorted(unknown), f"accounts of this site: {', '.join(site.accounts())}"
            )
        rules, configuration = access_rules(site, _template), broker_configuration(site, _template)
        for folder in (self._folder, self._broker, self._folder / "accounts"):
            make_folder(folder)
        names, is_new = merged(site.hosts, site.consoles), not (self._folder / "ca").exists()
        authority, lines = Authority(self._folder / "ca", names), []
        if is_new:
            lines.append(
                f"made a CA in {self._folder / 'ca'}, for {', '.join(names)} only; keep ca.key off the network"
            )
        elif renew_ca:
            authority.sign_anew(names)
            for path in (self._folder / "accounts").glob("*/ca.crt"):
                write_private(path, authority.certificate.read_bytes())
            lines.append(f"signed the CA's certificate anew, for {', '.join(names)} only: {_NEEDED}")
        elif missing := authority.not_permitted(names):
            found = f"the site's CA may not vouch for {', '.join(missing)}; --renew-ca signs its certificate anew: {_NEEDED}"
            raise ConstructionTwinError(found)
        servers = [("broker", self._broker / "server", before.get("hosts"), site.hosts)]
        if site.consoles:
            make_folder(self._console)
            servers.append(("console", self._console / "console", before.get("consoles"), site.consoles))
        for program, path, former, hosts in servers:
            certificate = path.with_suffix(".crt")
            if renew or former != hosts or not certificate.exists():
                authority.issue(f"construction_twin {program}", path.with_suffix(".key"), certificate, days, hosts)
                lines.append(f"signed the {program}'s certificate for {', '.join(hosts)}")
            write_private(path.with_name("ca.crt"), authority.certificate.read_bytes())
        lines += self._make_passwords(site, authority, replace)
        if site.certificates:
            lines += self._make_certificates(site, authority, days, renew, replace)
        if site.consoles:
            rights = {"robots": {robot: site.rights(robot) for robot in site.robots}}
            write_private(self._console / "rights.json", json.dumps(rights, indent=1) + "\n")
        write_private(self._broker / "access.acl", rules)
        write_private(self._broker / "mosquitto.conf", configuration)
        write_private(self._settings, json.dumps(dataclasses.asdict(site), indent=1) + "\n")
        return lines

    def expiries(self) -> list[str]:
        """Return a line per certificate with the day of its end."""
        found = [path for path in sorted(self._folder.rglob("*.crt")) if path.name != "ca.crt"]
        found.insert(0, self._folder / "ca/ca.crt")
        return [f"{path.relative_to(self._folder)} expires {expiry(path):%Y-%m-%d}" for path in found]

    def _make_passwords(self, site: Site, authority: Authority, replace: set[str]) -> list[str]:
        """Give every account that has none a password; accounts that are no longer of the site lose theirs."""
        path, names = self._broker / "passwords", site.accounts()
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        hashed = {line.partition(":")[0]: line for line in lines}
        gone = [f"took the password of {name} away: it is not in site.json" for name in hashed if name not in names]
        new = {name: secrets.token_urlsafe(24) for name in names if name in replace or name not in hashed}
        hashed |= _hash_passwords(new)
        for name, password in new.items():
            folder = self._folder / "accounts" / name
            make_folder(folder)
            write_private(folder / "password", password + "\n")
            write_private(folder / "ca.crt", authority.certificate.read_bytes())
            document = {"user": name, "password_file": "password", "ca_file": "ca.crt"}
            write_private(folder / "account.json", json.dumps(document) + "\n")
        write_private(path, "".join(f"{hashed[name]}\n" for name in names))
        return [f"made a password for {name}" for name in new] + gone

    def _make_certificates(
        self, site: Site, authority: Authority, days: int, renew: bool, replace: set[str]
    ) -> list[str]:
        lines = []
        for name in site.accounts():
            folder = self._folder / "accounts" / name
            certificate, key = folder / "client.crt", folder / "client.key"
            if name in replace and certificate.exists():
                lines.append(f"the old certificate of {name} opens the broker until {expiry(certificate):%Y-%m-%d}")
                key.unlink(missing_ok=True)
                certificate.unlink()
            # a folder that was handed out and deleted here is not made again
            if renew and not folder.exists():
                lines.append(f"not renewed: {name}, whose folder is not here; --replace makes it a new one")
            if not folder.exists() or (certificate.exists() and not (renew and key.exists())):
                continue
            authority.issue(name, key, certificate, days)
            document = {"cert_file": "client.crt", "key_file": "client.key", "ca_file": "ca.crt"}
            write_private(folder / "certificate.json", json.dumps(document) + "\n")
            lines.append(f"signed a certificate for {name}")
        return lines


def _template(name: str) -> str:
    return share_file(f"config/mosquitto/{name}").read_text(encoding="utf-8")


def _hash_passwords(passwords: dict[str, str]) -> dict[str, str]:
    """Return the lines of mosquitto's password file; no password stands on a command line, where every user could read it."""
    if not passwords:
        return {}
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch, "passwords")
        write_private(path, "".join(f"{name}:{password}\n" for name, password in passwords.items()))
        run_tool("mosquitto_passwd", "-U", path)
        lines = path.read_text(encoding="utf-8").splitlines()
    hashed = {line.partition(":")[0]: line for line in lines}
    if set(hashed) != set(passwords) or not all(re.fullmatch(r"[^:]+:\$\d\$.+", line) for line in lines):
        raise ConstructionTwinError("mosquitto_passwd did not hash the passwords; is it the one of mosquitto 2?")
    return hashed


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="make_site",
        description="Make a CA, the broker's certificate, accounts and access rules for a site. A second run adds what is new and "
        "keeps the rest.",
    )
    add = parser.add_argument
    add("folder", type=Path, help="folder of the site; keep it private")
    for option, metavar, what in (
        ("--host", "HOST", "name or address of the broker, as clients write it"),
        ("--robot", "ROBOT", "a robot"),
        (
            "--person",
            "NAME:RIGHTS[@ROBOTS]",
            "an account for a person or a program, e.g. ada:operate,approve@kr120_1,kr120_2; without @ at every robot; "
            f"rights: {', '.join(RIGHTS)}; replaces what the name had in a run before",
        ),
        ("--console", "HOST", "name or address of the console, as tablets write it: makes its certificate"),
        ("--replace", "ACCOUNT", "give this account a new password and key"),
    ):
        add(option, action="append", default=[], metavar=metavar, help=f"{what}; may be repeated")
    add("--plc", action="store_true", help="also an account for a PLC that commands in place of the bridge")
    add("--certificates", action="store_true", help="also client certificates, on the port above --port")
    add("--port", type=int, help="TLS port [8883]")
    add("--listen", metavar="ADDRESS", help="the broker's own address on which it listens [all of them]")
    add("--prefix", help="first level of the MQTT topics [twin]")
    add("--broker-folder", help="where the broker will find DIR/broker, e.g. /etc/mosquitto/site [DIR/broker]")
    add("--days", type=int, default=DAYS, help="lifetime of new certificates [%(default)s]")
    add("--renew", action="store_true", help="sign all certificates anew, for the same keys")
    add(
        "--renew-ca",
        action="store_true",
        help="sign the CA's certificate anew, for the same key and the site's names of now; then every tablet and client needs it",
    )
    return parser.parse_args(argv)


def _site(asked: argparse.Namespace, before: dict) -> Site:
    """Return the site of the last run, with what is asked for now; a person's rights in place of those before."""
    if not 1 <= asked.days <= 36500:
        raise ConfigurationError("--days", asked.days, "1 to 36500")
    named = {read_person(words)[0] for words in asked.person}
    others = [words for words in before.get("persons", ()) if read_person(words)[0] not in named]
    added = {
        "hosts": merged(before.get("hosts", ()), asked.host),
        "robots": merged(before.get("robots", ()), asked.robot),
        "consoles": merged(before.get("consoles", ()), asked.console),
        "persons": merged(others, asked.person),
        "folder": asked.broker_folder or before.get("folder") or str(asked.folder.absolute() / "broker"),
    }
    single = ("plc", "certificates", "port", "listen", "prefix")
    return Site(**before | added | {name: value for name in single if (value := getattr(asked, name))})


def main(argv: list[str] | None = None) -> int:
    """Make or extend a site; return the exit code."""
    asked = _arguments(argv)
    folder = SiteFolder(asked.folder)
    try:
        site = _site(asked, folder.load())
        lines = folder.create_missing(site, asked.days, asked.renew, asked.replace, asked.renew_ca) + folder.expiries()
    except (ConstructionTwinError, OSError) as error:
        print(f"make_site: {command_message(error)}")
        return 1
    print("\n".join(lines))
    print(f"broker: {asked.folder / 'broker/mosquitto.conf'} expects its files in {site.folder}")
    print(f"clients: port {site.port}, accounts in {asked.folder / 'accounts'}/<name>/account.json")
    if site.certificates:
        print(f"clients with a certificate: port {site.port + 1}, .../certificate.json")
    return 0
