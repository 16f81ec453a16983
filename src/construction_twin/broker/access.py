"""Rights at a site's broker, and mosquitto's files made of them. Pure; rules beside requests are in config/mosquitto/."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from string import Template

from construction_twin.core.errors import ConfigurationError
from construction_twin.mqtt.messages import Topics
from construction_twin.mqtt.requests import REQUESTS, STOP

#: What a person may do at a robot: `look` reads everything of it, the others are those of `mqtt.requests`. `look` comes with each,
#: and with each but `look` comes `stop`.
RIGHTS = ("look", "operate", "approve", "reset")
#: Programs of the link, each with rules of its own (``bridge.acl``); `plc` is made on request.
PROGRAMS, PLC = ("bridge", "gateway"), "plc"
#: What a person cannot be called: programs, what stands for an account where a broker knows none, and where answers come.
_RESERVED = (*PROGRAMS, PLC, "console", "ack")
_NAME = re.compile(r"[A-Za-z0-9_-]{1,32}")
#: Host names and addresses, IPv6 included: nothing that openssl's configuration could take for something else.
_HOST = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.:-]{0,251}[A-Za-z0-9])?|::1")
_PERSON = re.compile(r"([^:@]+):([^:@]+)(?:@([^:@]+))?")
_OF_ACCOUNTS = [kind for kind in REQUESTS if kind.right]


@dataclass(frozen=True)
class Site:
    """A site's hosts, robots and accounts; ConfigurationError for an invalid name.

    Attributes:
        hosts, consoles: Names and addresses under which clients reach the broker, and browsers the console.
        persons: Who may do what, as ``ada:operate,approve@kr120_1,kr120_2``; without ``@`` at every. Those of one name add up.
        plc: Also an account for a PLC that commands in place of the bridge.
        folder: Where the broker finds its files.
        listen: The address on which it listens; empty: all.
    """

    hosts: tuple[str, ...]
    robots: tuple[str, ...]
    persons: tuple[str, ...] = ()
    plc: bool = False
    port: int = 8883
    prefix: str = "twin"
    folder: str = ""
    listen: str = ""
    consoles: tuple[str, ...] = ()

    def __post_init__(self):
        for option, names, pattern in (
            ("--host", self.hosts, _HOST),
            ("--robot", self.robots, _NAME),
            ("--person", self.people(), _NAME),
            ("--console", self.consoles, _HOST),
            ("--prefix", (self.prefix,), _NAME),
            ("--listen", (self.listen,) if self.listen else (), _HOST),
        ):
            for name in names:
                if not pattern.fullmatch(name):
                    raise ConfigurationError(option, name, "letters, digits, - and _ (hosts: . and : too)")
        for option, names in (("--host", self.hosts), ("--robot", self.robots)):
            if not names:
                raise ConfigurationError(option, "", "at least one")
        if not 0 < self.port < 65536:
            raise ConfigurationError("--port", self.port, "1 to 65535")
        if not self.folder or re.search(r"\s", self.folder):
            raise ConfigurationError("--broker-folder", self.folder, "a path without spaces, for mosquitto.conf")
        for words in self.persons:
            name, rights, robots = read_person(words)
            for found, known in ((rights, RIGHTS), (robots, self.robots)):
                if unknown := sorted({*found} - {*known}):
                    raise ConfigurationError(f"--person {name}", unknown[0], f"one of {', '.join(known)}")
            # what a robot's program is called, or may be called: no two accounts have one name
            if name in _RESERVED or name.startswith(tuple(f"{robot}-" for robot in self.robots)):
                raise ConfigurationError("--person", name, "a name that no program's account has, or may have")

    def programs(self, robot: str) -> dict[str, str]:
        """Return a robot's machine accounts, and the program of each."""
        return {f"{robot}-{program}": program for program in (*PROGRAMS, *(PLC,) * self.plc)}

    def people(self) -> tuple[str, ...]:
        """Return the names of the people's accounts."""
        return union((), (read_person(words)[0] for words in self.persons))

    def accounts(self) -> list[str]:
        """Return the name of every account."""
        return [*(account for robot in self.robots for account in self.programs(robot)), *self.people()]

    def rights(self, robot: str) -> dict[str, list[str]]:
        """Return each person's rights at a robot, in the order of `RIGHTS`."""
        granted: dict[str, set[str]] = {}
        for name, rights, robots in map(read_person, self.persons):
            if robot in (robots or self.robots):
                granted.setdefault(name, {"look"}).update(rights)
        return {name: [right for right in RIGHTS if right in rights] for name, rights in granted.items()}


def read_person(words: str) -> tuple[str, tuple[str, ...], tuple[str, ...]]:
    """Parse an entry of `Site.persons` into name, rights and robots (empty: all)."""
    found = _PERSON.fullmatch(str(words))
    if found is None:
        raise ConfigurationError("--person", words, "NAME:RIGHTS[@ROBOTS], as ada:operate,approve@kr120_1,kr120_2")
    name, rights, robots = found.groups()
    return name, tuple(rights.split(",")), tuple(robots.split(",")) if robots else ()


def access_rules(site: Site, template: Callable[[str], str]) -> str:
    """Return mosquitto's ACL file; `template` returns the text of a file in config/mosquitto/, e.g. ``bridge.acl``."""
    parts = ["# Who may do what. Made by make_site; it is written anew with every run.\n"]
    for robot in site.robots:
        topics = Topics(site.prefix, robot)
        asked = [f"topic read {topics.of(kind)}" for kind in _OF_ACCOUNTS]
        requests = "\n".join([*asked, *dict.fromkeys(f"topic write {topics.ack_of(kind)}" for kind in _OF_ACCOUNTS)])
        for account, program in site.programs(robot).items():
            values = {"account": account, "topics": f"{site.prefix}/{robot}", "requests": requests}
            parts.append(Template(template(f"{program}.acl")).substitute(values))
    for name in site.people():
        lines = [f"user {name}"]
        for robot in site.robots:
            if rights := site.rights(robot).get(name):
                lines += [f"# {robot}: {', '.join(rights)}", f"topic read {site.prefix}/{robot}/#"]
                writes = [kind for kind in _OF_ACCOUNTS if kind.right in rights or (kind is STOP and len(rights) > 1)]
                lines += [f"topic write {Topics(site.prefix, robot).of(kind, name)}" for kind in writes]
        parts.append("\n".join([*lines, ""]))
    return "\n".join(parts)


def broker_configuration(site: Site, template: Callable[[str], str]) -> str:
    """Return mosquitto's configuration; parameters as in `access_rules`."""
    address = f" {site.listen}" if site.listen else ""
    return Template(template("site.conf")).substitute(folder=site.folder, port=site.port, address=address)


def union(old: Iterable[str], new: Iterable[str]) -> tuple[str, ...]:
    """Return the names of both, each once, in order."""
    return tuple(dict.fromkeys([*old, *new]))
