"""make_site: a broker's certificates, accounts and access rules for a site. Needs no ROS.

Each run signs the certificates anew; keys and passwords that exist stay. What shall be made anew is deleted first.
"""

from __future__ import annotations

import argparse
import dataclasses
import ipaddress
import json
import os
import re
import secrets
import shutil
import subprocess
import tempfile
from collections.abc import Iterable
from pathlib import Path

from construction_twin.broker.access import RIGHTS, Site, access_rules, broker_configuration, read_person, union
from construction_twin.core.errors import ConfigurationError, ConstructionTwinError, command_message
from construction_twin.core.share import share_file

#: Lifetime of a CA, and of a server's certificate: what most software accepts at most [days].
CA_DAYS, DAYS = 3650, 825
_CA = ("basicConstraints=critical,CA:true,pathlen:0", "keyUsage=critical,keyCertSign,cRLSign")
_SERVER = (
    "basicConstraints=critical,CA:false",
    "keyUsage=critical,digitalSignature",
    "extendedKeyUsage=serverAuth",
    "authorityKeyIdentifier=keyid",
)
_PACKAGES = {"openssl": "openssl", "mosquitto_passwd": "mosquitto"}


# -- files and programs


def write_private(path: Path, content: str | bytes) -> None:
    """Write a file in one step, readable by its owner only."""
    path.parent.mkdir(mode=0o700, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        with open(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def run_tool(program: str, *arguments: object) -> str:
    """Run a program; return its output. ConstructionTwinError where it is missing or fails."""
    found = shutil.which(program)
    if found is None:
        raise ConstructionTwinError(f"{program} is not installed; on Debian: apt-get install {_PACKAGES[program]}")
    done = subprocess.run([found, *map(str, arguments)], capture_output=True, text=True, umask=0o077, check=False)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise ConstructionTwinError(f"{program} {arguments[0]} failed with {done.returncode}: {last}")
    return done.stdout


# -- certificates


def sign(name: str, path: Path, days: int, extensions: Iterable[str], signer: Iterable[object] = ()) -> None:
    """Write ``path.crt``, self-signed without a signer, and ``path.key`` where it is missing."""
    key = path.with_suffix(".key")
    if not key.exists():
        write_private(key, run_tool("openssl", "genpkey", "-algorithm", "EC", "-pkeyopt", "ec_paramgen_curve:P-256"))
    options = [option for extension in extensions for option in ("-addext", extension)]
    # the machine's own configuration would add extensions
    request = ("req", "-x509", "-config", os.devnull, "-subj", f"/CN={name}", "-key", key, *signer, "-days", days)
    serial = f"0x{secrets.randbits(126) | 1 << 126:x}"
    more = ("-set_serial", serial, "-addext", "subjectKeyIdentifier=hash", *options)
    write_private(path.with_suffix(".crt"), run_tool("openssl", *request, *more))


def sign_authority(path: Path, hosts: Iterable[str]) -> None:
    """Write a CA restricted to these hosts, their subdomains and loopback."""
    permitted = sorted({_permitted(host) for host in (*hosts, "localhost", "127.0.0.1", "::1")})
    sign("construction_twin site", path, CA_DAYS, (*_CA, f"nameConstraints=critical,{','.join(permitted)}"))


def sign_server(name: str, path: Path, hosts: Iterable[str], ca: Path) -> None:
    """Write a server's certificate, and the CA's beside it."""
    names = f"subjectAltName={','.join(map(_alternative_name, hosts))}"
    signer = ("-CA", ca.with_suffix(".crt"), "-CAkey", ca.with_suffix(".key"))
    sign(f"construction_twin {name}", path, DAYS, (*_SERVER, names), signer)
    write_private(path.with_name("ca.crt"), ca.with_suffix(".crt").read_bytes())


def _permitted(host: str) -> str:
    name = _alternative_name(host)
    if name.startswith("DNS:"):
        return f"permitted;{name[:4]}{host.lower()}"
    return f"permitted;{name}/{ipaddress.ip_network(host).netmask}"


def _alternative_name(host: str) -> str:
    try:
        return f"IP:{ipaddress.ip_address(host)}"
    except ValueError:
        if set(host) <= set("0123456789.") or ":" in host:
            raise ConfigurationError("--host", host, "a host name, or an address like 192.168.1.10") from None
        return f"DNS:{host}"


# -- a site


def load_site(folder: Path) -> dict:
    """Read the settings of the last run; {} before the first."""
    path = folder / "site.json"
    if not path.exists():
        return {}
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        if unknown := {*document} - {field.name for field in dataclasses.fields(Site)}:
            raise ConstructionTwinError(f"{path} holds {', '.join(sorted(unknown))}, which no site has: take it out")
        return {key: tuple(value) if isinstance(value, list) else value for key, value in document.items()}
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise ConstructionTwinError(f"{path} cannot be read: {error}; restore it") from error


def make_site(folder: Path, site: Site) -> list[str]:
    """Write the site's files; return sentences on what is new. ConstructionTwinError where a program fails.

    Args:
        folder: Gets `ca/`, `broker/`, `accounts/<name>/`, `site.json`, and `console/` where the site has one.
    """
    rules, configuration = access_rules(site, _template), broker_configuration(site, _template)
    before, ca, hosts, lines = load_site(folder), folder / "ca/ca", union(site.hosts, site.consoles), []
    if before and not ca.with_suffix(".key").exists():
        raise ConstructionTwinError(f"{ca}.key is missing: put it back, or make the site anew in another folder")
    for each in (folder, folder / "accounts"):
        each.mkdir(mode=0o700, parents=True, exist_ok=True)
    if hosts != union(before.get("hosts", ()), before.get("consoles", ())) or not ca.with_suffix(".crt").exists():
        sign_authority(ca, hosts)
        lines.append(f"{ca}.crt is new, for {', '.join(hosts)} only: every tablet and every client needs it")
    sign_server("broker", folder / "broker/server", site.hosts, ca)
    if site.consoles:
        sign_server("console", folder / "console/console", site.consoles, ca)
        rights = {"robots": {robot: site.rights(robot) for robot in site.robots}}
        write_private(folder / "console/rights.json", json.dumps(rights, indent=1) + "\n")
    lines += _make_accounts(folder, site)
    for account in (folder / "accounts").glob("*/account.json"):
        write_private(account.with_name("ca.crt"), ca.with_suffix(".crt").read_bytes())
    write_private(folder / "broker/access.acl", rules)
    write_private(folder / "broker/mosquitto.conf", configuration)
    write_private(folder / "site.json", json.dumps(dataclasses.asdict(site), indent=1) + "\n")
    return lines


def _make_accounts(folder: Path, site: Site) -> list[str]:
    """Make passwords of new accounts, and drop those of removed ones."""
    path, names = folder / "broker/passwords", site.accounts()
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    hashed = {line.partition(":")[0]: line for line in lines}
    gone = [f"took the password of {name} away: it is not in site.json" for name in hashed if name not in names]
    new = {name: secrets.token_urlsafe(24) for name in names if name not in hashed}
    hashed |= _hash_passwords(new)
    for name, password in new.items():
        account = folder / "accounts" / name
        write_private(account / "password", password + "\n")
        document = {"user": name, "password_file": "password", "ca_file": "ca.crt"}
        write_private(account / "account.json", json.dumps(document) + "\n")
    write_private(path, "".join(f"{hashed[name]}\n" for name in names))
    return [f"made a password for {name}" for name in new] + gone


def _template(name: str) -> str:
    return share_file(f"config/mosquitto/{name}").read_text(encoding="utf-8")


def _hash_passwords(passwords: dict[str, str]) -> dict[str, str]:
    """Return the lines of mosquitto's password file; passwords stay off the command line."""
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
    description = (
        "Make a CA, certificates, accounts and access rules of a site's broker. A second run adds what is new."
    )
    parser = argparse.ArgumentParser(prog="make_site", description=description)
    add = parser.add_argument
    add("folder", type=Path, help="folder of the site; keep it private")
    person = (
        "an account for a person or a program, e.g. ada:operate,approve@kr120_1,kr120_2; without @ at every robot; "
    )
    person += f"rights: {', '.join(RIGHTS)}; replaces what the name had in a run before"
    for option, metavar, what in (
        ("--host", "HOST", "name or address of the broker, as clients write it"),
        ("--robot", "ROBOT", "a robot"),
        ("--person", "NAME:RIGHTS[@ROBOTS]", person),
        ("--console", "HOST", "name or address of the console, as tablets write it: makes its certificate"),
    ):
        add(option, action="append", default=[], metavar=metavar, help=f"{what}; may be repeated")
    add("--plc", action="store_true", help="also an account for a PLC that commands in place of the bridge")
    add("--port", type=int, help="TLS port [8883]")
    add("--listen", metavar="ADDRESS", help="the broker's own address on which it listens [all of them]")
    add("--prefix", help="first level of the MQTT topics [twin]")
    add("--broker-folder", help="where the broker will find DIR/broker, e.g. /etc/mosquitto/site [DIR/broker]")
    return parser.parse_args(argv)


def _site(asked: argparse.Namespace, before: dict) -> Site:
    """Merge the options into the site of the last run; a person's rights are replaced."""
    named = {read_person(words)[0] for words in asked.person}
    others = [words for words in before.get("persons", ()) if read_person(words)[0] not in named]
    added = {
        "hosts": union(before.get("hosts", ()), asked.host),
        "robots": union(before.get("robots", ()), asked.robot),
        "consoles": union(before.get("consoles", ()), asked.console),
        "persons": union(others, asked.person),
        "folder": asked.broker_folder or before.get("folder") or str(asked.folder.absolute() / "broker"),
    }
    single = ("plc", "port", "listen", "prefix")
    return Site(**before | added | {name: value for name in single if (value := getattr(asked, name))})


def main(argv: list[str] | None = None) -> int:
    """Make or extend a site; return the exit code."""
    asked = _arguments(argv)
    try:
        site = _site(asked, load_site(asked.folder))
        lines = make_site(asked.folder, site)
    except (ConstructionTwinError, OSError) as error:
        print(f"make_site: {command_message(error)}")
        return 1
    print("\n".join([*lines, f"the servers' certificates are good for {DAYS} days: run make_site again before"]))
    print(f"broker: {asked.folder / 'broker/mosquitto.conf'} expects its files in {site.folder}")
    print(f"clients: port {site.port}, accounts in {asked.folder / 'accounts'}/<name>/account.json")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
