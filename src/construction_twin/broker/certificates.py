"""A site's certificate authority: certificates for the broker and its clients, by the `openssl` program. Standard library only.

Keys are elliptic (P-256), without a passphrase, readable by their owner only. A key that exists is never replaced here; a
certificate is signed anew for the key that is there.
"""

from __future__ import annotations

import ipaddress
import os
import secrets
import shutil
import subprocess
import tempfile
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError

#: Lifetime of a CA [days].
CA_DAYS = 3650
_CA = ("basicConstraints=critical,CA:true,pathlen:0", "keyUsage=critical,keyCertSign,cRLSign")
_END = ("basicConstraints=critical,CA:false", "keyUsage=critical,digitalSignature", "authorityKeyIdentifier=keyid")


class Authority:
    """A CA in a folder of its own, `ca.key` and `ca.crt`; made when it is not there. ConstructionTwinError where openssl fails.

    Args:
        hosts: Names and addresses that a new CA may vouch for, beside names below them and this machine's loopback.
    """

    def __init__(self, folder: Path, hosts: Iterable[str]):
        self.certificate, self._key = folder / "ca.crt", folder / "ca.key"
        if self._key.exists() != self.certificate.exists():
            raise ConstructionTwinError(f"{folder} holds only one of ca.key and ca.crt; put the other one back")
        if self._key.exists():
            return
        make_folder(folder)
        make_key(self._key)
        self.sign_anew(hosts)

    def sign_anew(self, hosts: Iterable[str]) -> None:
        """Sign the CA's own certificate for its key, for these hosts only; what it has signed before stays signed."""
        permitted = ",".join(f"permitted;{each}" for each in sorted(_constraints(hosts)))
        extensions = (*_CA, f"nameConstraints=critical,{permitted}")
        write_private(self.certificate, _sign("construction_twin site", self._key, CA_DAYS, extensions))

    def not_permitted(self, hosts: Iterable[str]) -> list[str]:
        """Return those of the hosts that this CA may not vouch for: all, where its certificate names none and would do for any."""
        hosts = list(hosts)
        return hosts if self._permits("name.invalid") else [host for host in hosts if not self._permits(host)]

    def _permits(self, host: str) -> bool:
        with tempfile.TemporaryDirectory() as scratch:
            certificate = Path(scratch, "host.crt")
            self.issue("trial", Path(scratch, "host.key"), certificate, 1, (host,))
            try:
                openssl("verify", "-CAfile", self.certificate, certificate)
            except ConstructionTwinError:
                return False
        return True

    def issue(self, name: str, key: Path, certificate: Path, days: int, hosts: Iterable[str] = ()) -> None:
        """Sign a certificate for a key, which is made when it is not there: with `hosts` a server's, else a client's."""
        if not key.exists():
            make_key(key)
        hosts = tuple(hosts)
        extensions = [*_END, f"extendedKeyUsage={'serverAuth' if hosts else 'clientAuth'}"]
        if hosts:
            extensions.append(f"subjectAltName={','.join(map(_alternative_name, hosts))}")
        signer = ("-CA", self.certificate, "-CAkey", self._key)
        write_private(certificate, _sign(name, key, days, extensions, signer))


def _sign(name: str, key: Path, days: int, extensions: Iterable[str], signer: tuple[object, ...] = ()) -> str:
    """Return a new certificate (PEM) for a key; without a signer it is signed by that key itself."""
    options = [option for extension in extensions for option in ("-addext", extension)]
    # the machine's own configuration would add extensions
    request = ["req", "-x509", "-config", os.devnull, "-subj", f"/CN={name}", "-key", key, *signer]
    serial = f"0x{secrets.randbits(126) | 1 << 126:x}"
    return openssl(*request, "-days", days, "-set_serial", serial, "-addext", "subjectKeyIdentifier=hash", *options)


def expiry(certificate: Path) -> datetime:
    """Return when a certificate expires (UTC)."""
    text = openssl("x509", "-in", certificate, "-noout", "-enddate").strip()
    return datetime.strptime(text, "notAfter=%b %d %H:%M:%S %Y GMT").replace(tzinfo=UTC)


def make_key(path: Path) -> None:
    """Write a new private key, readable by its owner only."""
    write_private(path, openssl("genpkey", "-algorithm", "EC", "-pkeyopt", "ec_paramgen_curve:P-256"))


def make_folder(path: Path) -> None:
    """Make a folder that only its owner may open."""
    path.mkdir(mode=0o700, parents=True, exist_ok=True)


def write_private(path: Path, content: str | bytes) -> None:
    """Write a file in one step, readable by its owner only; a text as UTF-8."""
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        with open(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def run_tool(program: str, *arguments: object) -> str:
    """Run a program; return what it printed. ConstructionTwinError when it is not installed or fails."""
    found = shutil.which(program)
    if found is None:
        raise ConstructionTwinError(f"{program} is not installed; on Debian: apt-get install {_PACKAGES[program]}")
    done = subprocess.run([found, *map(str, arguments)], capture_output=True, text=True, umask=0o077, check=False)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise ConstructionTwinError(f"{program} {arguments[0]} failed with {done.returncode}: {last}")
    return done.stdout


_PACKAGES = {"openssl": "openssl", "mosquitto_passwd": "mosquitto"}


def openssl(*arguments: object) -> str:
    """Run openssl; return what it printed."""
    return run_tool("openssl", *arguments)


def _constraints(hosts: Iterable[str]) -> set[str]:
    """Return hosts and loopback as openssl writes permitted names and ranges; with none of a kind all of that kind would be."""
    found = set()
    for host in (*hosts, "localhost", "127.0.0.1", "::1"):
        name = _alternative_name(host)
        network = ipaddress.ip_network(name.removeprefix("IP:")) if name.startswith("IP:") else None
        found.add(f"DNS:{host.lower()}" if network is None else f"{name}/{network.netmask}")
    return found


def _alternative_name(host: str) -> str:
    try:
        return f"IP:{ipaddress.ip_address(host)}"
    except ValueError:
        if set(host) <= set("0123456789.") or ":" in host:
            raise ConfigurationError("--host", host, "a host name, or an address like 192.168.1.10") from None
        return f"DNS:{host}"
