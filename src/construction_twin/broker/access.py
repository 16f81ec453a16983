"""Who may do what at a site's broker: roles, their accounts, and mosquitto's files for them. Pure; the texts are templates in
config/mosquitto/.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from string import Template

from construction_twin.core.errors import ConfigurationError

#: Roles that every robot has; `planner` and `plc` are made on request.
ROLES = ("bridge", "gateway", "tablet", "viewer")
PLANNER, PLC = "planner", "plc"
_NAME = re.compile(r"[A-Za-z0-9_-]{1,32}")
#: Host names and addresses, IPv6 included: nothing that openssl's configuration could take for something else.
_HOST = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.:-]{0,251}[A-Za-z0-9])?|::1")


@dataclass(frozen=True)
class SiteAccount:
    """One account: a role at one robot; `person` is empty, or names the owner of a tablet or a planner."""

    robot: str
    role: str
    person: str = ""

    @property
    def name(self) -> str:
        """MQTT user name, and common name of the certificate."""
        return "-".join(filter(None, (self.robot, self.role, self.person)))


@dataclass(frozen=True)
class Site:
    """What a site consists of.

    Attributes
    ----------
    hosts : tuple of str
        Names and addresses under which clients reach the broker.
    robots : tuple of str
    people : tuple of str
        Each gets a tablet account of its own at every robot; empty: one tablet account per robot.
    shared : tuple of str
        Robots that have that one tablet account beside those of people, from a run before there were any.
    planners : tuple of str
        People or programs that plan elsewhere: each gets an account of its own at every robot.
    plc : bool
        Also an account for a PLC that commands in place of the bridge.
    certificates : bool
        Also a listener for client certificates.
    port : int
        TLS port; client certificates use the one above it.
    prefix : str
        First level of the MQTT topics.
    folder : str
        Where the broker finds its files.
    listen : str
        The broker's own address on which it listens; empty: all of them.

    Raises
    ------
    ConfigurationError
        When a name could not stand in a topic, an access rule or a certificate.
    """

    hosts: tuple[str, ...]
    robots: tuple[str, ...]
    people: tuple[str, ...] = field(default=())
    plc: bool = False
    certificates: bool = False
    port: int = 8883
    prefix: str = "twin"
    folder: str = ""
    listen: str = ""
    shared: tuple[str, ...] = field(default=())
    planners: tuple[str, ...] = field(default=())

    def __post_init__(self):
        for option, names, pattern in (
            ("--host", self.hosts, _HOST),
            ("--robot", self.robots, _NAME),
            ("--tablet", self.people, _NAME),
            ("--planner", self.planners, _NAME),
            ("--prefix", (self.prefix,), _NAME),
            ("--listen", (self.listen,) if self.listen else (), _HOST),
        ):
            for name in names:
                if not pattern.fullmatch(name):
                    raise ConfigurationError(option, name, "letters, digits, - and _ (hosts: . and : too)")
        for option, names in (("--host", self.hosts), ("--robot", self.robots)):
            if not names:
                raise ConfigurationError(option, "", "at least one")
        if not 0 < self.port < 65535:
            raise ConfigurationError("--port", self.port, "1 to 65534; client certificates use the one above it")
        if not self.folder or re.search(r"\s", self.folder):
            raise ConfigurationError(
                "--broker-folder", self.folder, "a path without spaces: mosquitto.conf cannot hold them"
            )
        accounts = [account.name for account in self.accounts()]
        if len(set(accounts)) != len(accounts):
            raise ConfigurationError(
                "--robot, --tablet and --planner", sorted(accounts), "names that give every account a name of its own"
            )

    def accounts(self) -> list[SiteAccount]:
        """Return every account, in the order of the robots."""
        accounts = []
        for robot in self.robots:
            tablets = ("",) * (not self.people or robot in self.shared) + self.people
            for role in ROLES + (PLC,) * self.plc:
                accounts += [SiteAccount(robot, role, person) for person in (tablets if role == "tablet" else ("",))]
            accounts += [SiteAccount(robot, PLANNER, person) for person in self.planners]
        return accounts


def access_rules(site: Site, template: Callable[[str], str]) -> str:
    """Return mosquitto's ACL file.

    Parameters
    ----------
    site : Site
    template : callable
        Returns the text of a file in config/mosquitto/, e.g. ``bridge.acl``.
    """
    parts = ["# Who may do what. Made by make_site from config/mosquitto/; it is written anew with every run.\n"]
    for account in site.accounts():
        text = template(f"{account.role}.acl")
        parts.append(
            _filled(f"{account.role}.acl", text, account=account.name, topics=f"{site.prefix}/{account.robot}")
        )
    return "\n".join(parts)


def broker_configuration(site: Site, template: Callable[[str], str]) -> str:
    """Return mosquitto's configuration; parameters as in `access_rules`."""
    names = ["site.conf", "site_certificates.conf"] if site.certificates else ["site.conf"]
    values = {"folder": site.folder, "port": site.port, "certificate_port": site.port + 1}
    values["address"] = f" {site.listen}" if site.listen else ""
    return "".join(_filled(name, template(name), **values) for name in names)


def _filled(name: str, text: str, **values: object) -> str:
    try:
        return Template(text).substitute(values)
    except (KeyError, ValueError) as error:
        expected = "no other names after $ than " + ", ".join(values)
        raise ConfigurationError(f"template {name}", str(error), expected) from error


def merged(old: Iterable[str], new: Iterable[str]) -> tuple[str, ...]:
    """Return the names of both, each once, in order."""
    return tuple(dict.fromkeys([*old, *new]))
