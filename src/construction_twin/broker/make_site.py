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
from collections.abc import Iterable, Mapping
from datetime import UTC
from pathlib import Path

from construction_twin.broker.access import (
    RIGHTS,
    ROLES,
    Grant,
    Person,
    Site,
    SiteAccount,
    access_rules,
    broker_configuration,
    merged,
    people_of,
)
from construction_twin.broker.certificates import Authority, expiry, make_folder, run_tool, write_private
from construction_twin.core.errors import ConfigurationError, ConstructionTwinError, spoken
from construction_twin.core.sentences import Sentence
from construction_twin.core.share import share_file

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


_TEMPLATES = share_file("config/mosquitto")
#: Where `site.json` keeps the names of people, by role.
_FIELDS = {role: f"{role}s" for role in ROLES}
_SERVER = "construction_twin broker"
#: Lifetime of certificates [days]: what most software accepts at most.
DAYS = 825


class SiteFolder:
    """The files of a site: `ca/`, `broker/` for the broker, `console/` for the console, `accounts/<name>/` for the holder of that
    account, `site.json`.
    """

    def __init__(self, folder: Path, templates: Path = _TEMPLATES):
        self._folder = folder
        self._templates = templates
        self._broker = folder / "broker"
        self._console = ConsoleFiles(folder / "console")
        self._settings = folder / "site.json"

    def load(self) -> dict:
        """Return the settings of the last run, empty before the first one; ConstructionTwinError when they cannot be read."""
        if not self._settings.exists():
            return {}
        try:
            document = json.loads(self._settings.read_text(encoding="utf-8"))
            return {key: tuple(value) if isinstance(value, list) else value for key, value in document.items()}
        except (OSError, ValueError, AttributeError) as error:
            raise ConstructionTwinError(
                Sentence("view.site.unreadable", file=str(self._settings), problem=str(error))
            ) from error

    def make(
        self, site: Site, days: int = DAYS, renew: bool = False, replace: Iterable[str] = (), renew_ca: bool = False
    ) -> list[str]:
        """Make what is missing; return sentences on what was done.

        Args:
            days: Lifetime of new certificates.
            renew: Sign all certificates anew, for the same keys.
            replace: Accounts that get a new password and a new key.
            renew_ca: Sign the CA's certificate anew, for the same key, and for the names of this site.

        Raises:
            ConstructionTwinError: When a program is missing, a name does not fit, or the CA may not vouch for one.
        """
        replace = set(replace)
        unknown = replace - {account.name for account in site.accounts()}
        if unknown:
            known = ", ".join(account.name for account in site.accounts())
            raise ConfigurationError("--replace", sorted(unknown), Sentence("expected.site.known", accounts=known))
        before = self.load()
        rules, configuration = access_rules(site, self._template), broker_configuration(site, self._template)
        for folder in (self._folder, self._broker, self._folder / "accounts"):
            make_folder(folder)
        authority, lines = self._authority(tuple(dict.fromkeys((*site.hosts, *site.consoles))), renew_ca)
        if renew or before.get("hosts") != site.hosts or not (self._broker / "server.crt").exists():
            authority.issue(_SERVER, self._broker / "server.key", self._broker / "server.crt", days, site.hosts)
            lines.append(f"signed the broker's certificate for {', '.join(site.hosts)}")
        lines += self._make_passwords(site, authority, replace)
        if not _names_reviewers(before):
            kept = [SiteAccount(robot, "reviewer").name for robot in site.shared]
            lines += [
                f"kept {name}, an account without a person; --replace shuts out everyone who has its password"
                for name in kept
            ]
        if site.certificates:
            lines += self._make_certificates(site, authority, days, renew, replace)
        lines += self._console.make(site, before.get("consoles", ()), authority, days, renew)
        ca = authority.certificate.read_text(encoding="utf-8")
        write_private(self._broker / "ca.crt", ca)
        write_private(self._broker / "access.acl", rules)
        write_private(self._broker / "mosquitto.conf", configuration)
        write_private(self._settings, json.dumps(dataclasses.asdict(site), indent=1) + "\n")
        return lines

    def _authority(self, names: tuple[str, ...], renew: bool) -> tuple[Authority, list[str]]:
        """Return the site's CA, which may vouch for these names, and sentences on what was done."""
        folder, made = self._folder / "ca", not (self._folder / "ca").exists()
        authority = Authority(folder, "construction_twin site", names)
        if made:
            return authority, [f"made a CA in {folder}, for {', '.join(names)} only; keep ca.key off the network"]
        if renew:
            authority.sign_anew(names)
            ca = authority.certificate.read_text(encoding="utf-8")
            for path in (self._folder / "accounts").glob("*/ca.crt"):
                write_private(path, ca)
            return authority, [
                f"signed the CA's certificate anew, for {', '.join(names)} only, with the same key: every tablet and every client "
                "needs the new ca.crt"
            ]
        if missing := authority.not_permitted(names):
            raise ConstructionTwinError(Sentence("view.site.not_permitted", names=", ".join(missing)))
        return authority, []

    def expiries(self) -> list[str]:
        """Return a line per certificate with the day of its end, and a warning when the CA's comes first."""
        found = [self._folder / "ca/ca.crt", self._broker / "server.crt"]
        found += [self._console.certificate] * self._console.certificate.exists()
        found += sorted((self._folder / "accounts").glob("*/client.crt"))
        ends = [expiry(path).astimezone(UTC) for path in found]
        lines = [f"{path.relative_to(self._folder)} expires {end:%Y-%m-%d}" for path, end in zip(found, ends)]
        if max(ends) > ends[0]:
            lines.append(
                f"warning: the CA ends on {ends[0]:%Y-%m-%d}, and with it every certificate, whatever stands in it; "
                "before that run it with --renew-ca, and give everybody the new ca.crt (docs/broker.md)"
            )
        return lines

    def _template(self, name: str) -> str:
        try:
            return (self._templates / name).read_text(encoding="utf-8")
        except OSError as error:
            raise ConstructionTwinError(
                Sentence("view.site.no_template", file=str(self._templates / name), problem=str(error.strerror))
            ) from error

    def _account_folder(self, account: SiteAccount) -> Path:
        return self._folder / "accounts" / account.name

    def _make_passwords(self, site: Site, authority: Authority, replace: set[str]) -> list[str]:
        """Give every account that has none a password; accounts that were taken out of `site.json` lose theirs."""
        path = self._broker / "passwords"
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        hashed = {line.partition(":")[0]: line for line in lines}
        new = {
            account: secrets.token_urlsafe(24)
            for account in site.accounts()
            if account.name in replace or account.name not in hashed
        }
        hashed |= _hash_passwords({account.name: password for account, password in new.items()})
        for account, password in new.items():
            folder = self._account_folder(account)
            make_folder(folder)
            write_private(folder / "password", password + "\n")
            write_private(folder / "ca.crt", authority.certificate.read_text(encoding="utf-8"))
            document = {"user": account.name, "password_file": "password", "ca_file": "ca.crt"}
            write_private(folder / "account.json", json.dumps(document) + "\n")
        names = [account.name for account in site.accounts()]
        write_private(path, "".join(f"{hashed[name]}\n" for name in names))
        gone = [f"took the password of {name} away: it is not in site.json" for name in hashed if name not in names]
        return [f"made a password for {account.name}" for account in new] + gone

    def _make_certificates(
        self, site: Site, authority: Authority, days: int, renew: bool, replace: set[str]
    ) -> list[str]:
        lines = []
        for account in site.accounts():
            folder = self._account_folder(account)
            certificate, key = folder / "client.crt", folder / "client.key"
            if account.name in replace and certificate.exists():
                lines.append(
                    f"the old certificate of {account.name} opens the broker until {expiry(certificate):%Y-%m-%d}"
                )
                key.unlink(missing_ok=True)
                certificate.unlink()
            # a folder that was handed out and deleted here is not made again
            if renew and not folder.exists():
                lines.append(f"not renewed: {account.name}, whose folder is not here; --replace makes it a new one")
            if not folder.exists() or (certificate.exists() and not (renew and key.exists())):
                continue
            authority.issue(account.name, key, certificate, days)
            document = {"cert_file": "client.crt", "key_file": "client.key", "ca_file": "ca.crt"}
            write_private(folder / "certificate.json", json.dumps(document) + "\n")
            lines.append(f"signed a certificate for {account.name}")
        return lines


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
        raise ConstructionTwinError(Sentence("view.site.no_hashes"))
    return hashed


#: What is said of `--reviewer` and so on.
_ROLE_HELP = {
    "reviewer": "an account for a person who approves and rejects plans",
    "stopper": "an account for a person who may stop and pause",
    "viewer": "an account for a person who only watches",
    "planner": "an account for a person or program that plans, on the page or elsewhere, e.g. in Grasshopper",
}


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="make_site",
        description="Make a CA, the broker's certificate, accounts and access rules for a site. A second run adds what is new and "
        "keeps the rest.",
    )
    add = parser.add_argument
    add("folder", type=Path, help="folder of the site; keep it private")
    add(
        "--host",
        action="append",
        default=[],
        help="name or address of the broker, as clients write it; may be repeated",
    )
    add("--robot", action="append", default=[], help="a robot; may be repeated")
    for role, what in _ROLE_HELP.items():
        rights = ", ".join(ROLES[role])
        add(f"--{role}", action="append", default=[], metavar="NAME", help=f"{what}; rights: {rights}; may be repeated")
    add(
        "--person",
        action="append",
        default=[],
        metavar="NAME:RIGHTS[@ROBOTS]",
        help="one account for a person at several robots, e.g. ada:plan_request,review@kr120_1,kr120_2; without @ at all of "
        f"them; rights: {', '.join(RIGHTS)}; whoever may set an arm in motion may stop it; may be repeated, also for one name; "
        "a name that there is gets these rights in place of those before",
    )
    add(
        "--console",
        action="append",
        default=[],
        metavar="HOST",
        help="name or address of the console, as tablets write it: makes its certificate and links; may be repeated",
    )
    add("--console-port", type=int, help="TCP port of the console [8480]")
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
    add("--replace", action="append", default=[], metavar="ACCOUNT", help="give this account a new password and key")
    add("--templates", type=Path, default=_TEMPLATES, help="folder of the templates for mosquitto [%(default)s]")
    return parser.parse_args(argv)


def _site(arguments: argparse.Namespace, before: dict) -> Site:
    if not 1 <= arguments.days <= 36500:
        raise ConfigurationError("--days", arguments.days, Sentence("expected.range", lowest=1, largest=36500))
    named = {role: merged(before.get(field, ()), getattr(arguments, role)) for role, field in _FIELDS.items()}
    persons = _persons(arguments.person, before.get("persons", ()))
    # without reviewers by name every robot has an account that they share, which may be in use
    shared = before.get("shared", ()) if _names_reviewers(before) else before.get("robots", ())
    reviewed = named["reviewer"] or any("review" in grant.rights for person in persons for grant in person.grants)
    given = {
        "hosts": merged(before.get("hosts", ()), arguments.host),
        "robots": merged(before.get("robots", ()), arguments.robot),
        **{field: named[role] for role, field in _FIELDS.items()},
        "persons": persons,
        "shared": shared if reviewed else (),
        "plc": arguments.plc or before.get("plc", False),
        "certificates": arguments.certificates or before.get("certificates", False),
        "consoles": merged(before.get("consoles", ()), arguments.console),
        "console_port": arguments.console_port or before.get("console_port", 8480),
        "port": arguments.port or before.get("port", 8883),
        "listen": arguments.listen or before.get("listen", ""),
        "prefix": arguments.prefix or before.get("prefix", "twin"),
        "folder": arguments.broker_folder or before.get("folder") or str(arguments.folder.absolute() / "broker"),
    }
    return Site(**given)


def _names_reviewers(settings: Mapping) -> bool:
    """Return whether the settings of a run name somebody who may review."""
    grants = (grant for person in settings.get("persons", ()) for grant in person["grants"])
    return bool(settings.get("reviewers")) or any("review" in grant["rights"] for grant in grants)


def _persons(given: Iterable[str], before: Iterable[Mapping]) -> tuple[Person, ...]:
    """Return the people with one account each: those of before, and those who are given now in place of their own of before."""
    persons = {}
    for one in before:
        grants = tuple(Grant(tuple(grant["rights"]), tuple(grant["robots"])) for grant in one["grants"])
        persons[one["name"]] = Person(one["name"], grants)
    now: dict[str, Person] = {}
    for words in given:
        person = Person.parse(words)
        grants = now[person.name].grants if person.name in now else ()
        now[person.name] = Person(person.name, (*grants, *person.grants))
    return tuple((persons | now).values())


def main(argv: list[str] | None = None) -> int:
    """Make or extend a site; return the exit code."""
    arguments = _arguments(argv)
    folder = SiteFolder(arguments.folder, arguments.templates)
    try:
        site = _site(arguments, folder.load())
        lines = folder.make(site, arguments.days, arguments.renew, arguments.replace, arguments.renew_ca)
        lines += folder.expiries()
    except (ConstructionTwinError, OSError) as error:
        print(f"make_site: {spoken(error)}")
        return 1
    print("\n".join(lines))
    print(f"broker: {arguments.folder / 'broker/mosquitto.conf'} expects its files in {site.folder}")
    print(f"clients: port {site.port}, accounts in {arguments.folder / 'accounts'}/<name>/account.json")
    for address in site.console_addresses():
        print(f"console: {address} with {arguments.folder / 'console/console.crt'} and console.key")
    if site.certificates:
        print(f"clients with a certificate: port {site.port + 1}, .../certificate.json")
    return 0
