"""Who may do what at a site's broker: roles, their accounts, and mosquitto's files for them. Pure; the texts are templates in
config/mosquitto/.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from string import Template

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.sentences import Sentence
from construction_twin.mqtt.messages import Topics
from construction_twin.mqtt.requests import REQUESTS

_OF_ACCOUNTS = [kind for kind in REQUESTS if kind.right]
#: What a right lets an account do is its template, ``right_<right>.acl``, with the topics of its requests in it. Each right has
#: topics of its own, so the broker alone decides.
RIGHTS = ("view", *dict.fromkeys(kind.right for kind in _OF_ACCOUNTS))
#: Whoever has one of these may set an arm in motion, let it go on or go faster, and so may stop it. Nobody has `reset`, `arm`,
#: `answer`, `acknowledge`, `speed` and `override_rehearsal` but a `Person` for whom they are named.
MOVING = ("review", "pause", "plan_request", "trajectory", "reset", "arm", "speed", "override_rehearsal")


def _seeing(*rights: str) -> tuple[str, ...]:
    """Return the rights of who sees a robot and has others; `stop` with those of `MOVING`."""
    return ("view", *(("stop",) if {*MOVING} & {*rights} else ()), *rights)


#: Roles of people, and of programs in their place: lists of rights.
ROLES = {
    "viewer": _seeing(),
    "stopper": _seeing("pause"),
    "planner": _seeing("plan_request", "trajectory"),
    "reviewer": _seeing("pause", "review"),
}
#: Programs of the link, each with rules of its own (``bridge.acl``); `plc` is made on request.
PROGRAMS, PLC = ("bridge", "gateway"), "plc"
#: What a person cannot be called: programs, and what stands for an account where a broker knows none.
_RESERVED = (*PROGRAMS, PLC, "console")
_NAME = re.compile(r"[A-Za-z0-9_-]{1,32}")
#: Host names and addresses, IPv6 included: nothing that openssl's configuration could take for something else.
_HOST = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.:-]{0,251}[A-Za-z0-9])?|::1")


@dataclass(frozen=True)
class Grant:
    """What a person may do at some robots.

    Attributes:
        rights: Of `RIGHTS`; `view` and, with those of `MOVING`, `stop` come with them.
        robots: Empty: every robot of the site.
    """

    rights: tuple[str, ...]
    robots: tuple[str, ...] = ()


@dataclass(frozen=True)
class Person:
    """A person with one account, which has the person's name, for all robots.

    Attributes:
        grants: Those of one robot add up.
    """

    name: str
    grants: tuple[Grant, ...]

    @classmethod
    def parse(cls, words: str) -> Person:
        """Return what ``ada:plan_request,review@kr120_1,kr120_2`` says: name, rights, and at which robots; without ``@`` at all.

        Raises:
            ConfigurationError: When it has another form, or names an unknown right.
        """
        found = re.fullmatch(r"([^:@]+):([^:@]+)(?:@([^:@]+))?", words)
        if found is None:
            raise ConfigurationError("--person", words, Sentence("expected.site.person"))
        name, rights, robots = found.groups()
        grant = Grant(tuple(rights.split(",")), tuple(robots.split(",")) if robots else ())
        if unknown := set(grant.rights) - set(RIGHTS):
            raise ConfigurationError(
                "--person", sorted(unknown)[0], Sentence("expected.one_of", known=", ".join(RIGHTS))
            )
        return cls(name, (grant,))

    def rights(self, robot: str) -> tuple[str, ...]:
        """Return the rights at a robot, in the order of `RIGHTS`; none where no grant is of it."""
        given = {right for grant in self.grants if robot in (grant.robots or (robot,)) for right in grant.rights}
        seeing = _seeing(*given - {"view", "stop"}, *given & {"stop"}) if given else ()
        return tuple(right for right in RIGHTS if right in seeing)


@dataclass(frozen=True)
class SiteAccount:
    """One account: a role at one robot, whose owner `person` names, if it has one; without both all robots of a `Person`."""

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

    Attributes:
        hosts: Names and addresses under which clients reach the broker.
        reviewers, stoppers, viewers, planners: People, who each get an account of their own at every robot, in that role. Without
            anybody who may review, every robot has one account for all who do.
        persons: People who have one account for several robots, each with rights of their own.
        shared: Robots that have that account without a person beside those of people, from a run before there were any.
        plc: Also an account for a PLC that commands in place of the bridge.
        certificates: Also a listener for client certificates.
        port: TLS port; client certificates use the one above it.
        prefix: First level of the MQTT topics.
        consoles: Names and addresses under which browsers reach the console; empty: no files for one.
        console_port: Its TCP port.
        folder: Where the broker finds its files.
        listen: The broker's own address on which it listens; empty: all of them.

    Raises:
        ConfigurationError: When a name could not stand in a topic, an access rule or a certificate.
    """

    hosts: tuple[str, ...]
    robots: tuple[str, ...]
    plc: bool = False
    certificates: bool = False
    port: int = 8883
    prefix: str = "twin"
    folder: str = ""
    listen: str = ""
    shared: tuple[str, ...] = field(default=())
    planners: tuple[str, ...] = field(default=())
    reviewers: tuple[str, ...] = field(default=())
    stoppers: tuple[str, ...] = field(default=())
    viewers: tuple[str, ...] = field(default=())
    persons: tuple[Person, ...] = field(default=())
    consoles: tuple[str, ...] = field(default=())
    console_port: int = 8480

    def __post_init__(self):
        for option, names, pattern in (
            ("--host", self.hosts, _HOST),
            ("--robot", self.robots, _NAME),
            *((f"--{role}", self.named(role), _NAME) for role in ROLES),
            ("--person", tuple(person.name for person in self.persons), _NAME),
            ("--console", self.consoles, _HOST),
            ("--prefix", (self.prefix,), _NAME),
            ("--listen", (self.listen,) if self.listen else (), _HOST),
        ):
            for name in names:
                if not pattern.fullmatch(name):
                    raise ConfigurationError(option, name, Sentence("expected.site.names"))
        for option, names in (("--host", self.hosts), ("--robot", self.robots)):
            if not names:
                raise ConfigurationError(option, "", Sentence("expected.at_least_one"))
        if not 0 < self.port < 65535:
            raise ConfigurationError("--port", self.port, Sentence("expected.site.port"))
        if not 0 < self.console_port < 65536:
            raise ConfigurationError(
                "--console-port", self.console_port, Sentence("expected.range", lowest=1, largest=65535)
            )
        if not self.folder or re.search(r"\s", self.folder):
            raise ConfigurationError("--broker-folder", self.folder, Sentence("expected.site.folder"))
        for person in self.persons:
            if unknown := {robot for grant in person.grants for robot in grant.robots} - set(self.robots):
                known = Sentence("expected.one_of", known=", ".join(self.robots))
                raise ConfigurationError(f"--person {person.name}", sorted(unknown)[0], known)
            # what a program, or an account of a role, is called or may be called
            taken = person.name in _RESERVED or person.name.startswith(tuple(f"{robot}-" for robot in self.robots))
            if taken:
                raise ConfigurationError("--person", person.name, Sentence("expected.site.person_name"))
        accounts = [account.name for account in self.accounts()]
        if len(set(accounts)) != len(accounts):
            raise ConfigurationError(
                "--robot and the names of people",
                sorted(accounts),
                Sentence("expected.site.accounts"),
            )

    def named(self, role: str) -> tuple[str, ...]:
        """Return who has a role of `ROLES` by name."""
        return getattr(self, f"{role}s")

    def are_reviewed(self, robot: str) -> bool:
        """Return whether somebody with one account may approve plans of a robot."""
        return any("review" in person.rights(robot) for person in self.persons)

    def accounts(self) -> list[SiteAccount]:
        """Return every account, in the order of the robots."""
        accounts = []
        for robot in self.robots:
            accounts += [SiteAccount(robot, role) for role in PROGRAMS + (PLC,) * self.plc]
            if robot in self.shared or not (self.reviewers or self.are_reviewed(robot)):
                accounts.append(SiteAccount(robot, "reviewer"))
            accounts.append(SiteAccount(robot, "viewer"))
            accounts += [SiteAccount(robot, role, person) for role in ROLES for person in self.named(role)]
        for person in self.persons:
            accounts.append(SiteAccount("", "", person.name))
        return accounts

    def console_addresses(self) -> list[str]:
        """Return what a person's browser opens, per name of the console."""
        return [f"https://{_in_address(host)}:{self.console_port}/" for host in self.consoles]


def people_of(site: Site) -> dict[str, dict[str, dict[str, str]]]:
    """Return who has which right: by robot and right, each person's account and name.

    For a page, which shows what an account can do and who else can; who really may do what stays the broker's to decide. Programs
    are left out.
    """
    found: dict[str, dict[str, dict[str, str]]] = {robot: {right: {} for right in RIGHTS} for robot in site.robots}
    for account in site.accounts():
        if not account.robot:
            continue
        for right in ROLES.get(account.role, ()):
            found[account.robot][right][account.name] = account.person or account.role
    for person in site.persons:
        for robot in site.robots:
            for right in person.rights(robot):
                found[robot][right][person.name] = person.name
    return found


def access_rules(site: Site, template: Callable[[str], str]) -> str:
    """Return mosquitto's ACL file.

    Args:
        template: Returns the text of a file in config/mosquitto/, e.g. ``bridge.acl``.
    """
    parts = ["# Who may do what. Made by make_site from config/mosquitto/; it is written anew with every run.\n"]
    for account in site.accounts():
        if not account.robot:
            continue
        if rights := ROLES.get(account.role):
            head = f"# {account.role}: {', '.join(rights)}\nuser {account.name}\n"
            parts.append(head + _rules(site, account.robot, account.name, rights, template))
            continue
        topics, name = Topics(site.prefix, account.robot), f"{account.role}.acl"
        values = {"account": account.name, "topics": f"{site.prefix}/{account.robot}", "requests": _answering(topics)}
        parts.append(_filled(name, template(name), **values))
    for person in site.persons:
        head = f"user {person.name}\n"
        for robot in site.robots:
            if rights := person.rights(robot):
                head += f"# {robot}: {', '.join(rights)}\n" + _rules(site, robot, person.name, rights, template)
        parts.append(head)
    return "\n".join(parts)


def _rules(site: Site, robot: str, account: str, rights: Iterable[str], template: Callable[[str], str]) -> str:
    """Return what rights let an account do at a robot."""
    topics, rules = Topics(site.prefix, robot), ""
    for right in rights:
        name, values = f"right_{right}.acl", {"account": account, "topics": f"{site.prefix}/{robot}"}
        rules += _filled(name, template(name), **values, writes=_asking(topics, right, account))
    return rules


def _asking(topics: Topics, right: str, account: str) -> str:
    """Return the rules of who may ask for what a right is about."""
    return "\n".join(f"topic write {topics.of(kind, account)}" for kind in _OF_ACCOUNTS if kind.right == right)


def _answering(topics: Topics) -> str:
    """Return the rules of who takes all requests of accounts, and answers them."""
    asked = [f"topic read {topics.of(kind)}" for kind in _OF_ACCOUNTS]
    return "\n".join([*asked, *dict.fromkeys(f"topic write {topics.ack_of(kind)}" for kind in _OF_ACCOUNTS)])


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
        expected = Sentence("expected.site.template", names=", ".join(values))
        raise ConfigurationError(f"template {name}", str(error), expected) from error


def _in_address(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def merged(old: Iterable[str], new: Iterable[str]) -> tuple[str, ...]:
    """Return the names of both, each once, in order."""
    return tuple(dict.fromkeys([*old, *new]))
