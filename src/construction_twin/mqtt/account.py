"""Who a program is to the broker, and how it knows the broker: the account file, and TLS. Standard library only.

An account file is JSON and holds names of files, never a secret; relative names start at its own folder. `make_site` writes
one per account; for another broker it is written by hand::

    {"user": "kr120-gateway", "ca_file": "ca.crt", "password_file": "password"}
    {"ca_file": "ca.crt", "cert_file": "client.crt", "key_file": "client.key"}
"""

from __future__ import annotations

import json
import os
import ssl
import stat
from dataclasses import dataclass, fields
from pathlib import Path

from construction_twin.core.errors import ConfigurationError

#: An account file, and a password file, are short; anything longer is something else [bytes].
_MAX_BYTES = 65536


@dataclass(frozen=True)
class Account:
    """An account on a broker: a user with a password, or a client certificate. Empty means none.

    Attributes:
        password_file: The password is its first line; only the owner may read it.
        ca_file: Certificates (PEM) of who signed the broker's; with it the connection is TLS.
        cert_file, key_file: Client certificate and its key (PEM, without a passphrase).
        name: What messages call it: the account file, or the user.
    """

    user: str = ""
    password_file: str = ""
    ca_file: str = ""
    cert_file: str = ""
    key_file: str = ""
    name: str = "account"

    def __post_init__(self):
        for one, other in (("user", "password_file"), ("cert_file", "key_file")):
            if bool(getattr(self, one)) != bool(getattr(self, other)):
                missing = other if getattr(self, one) else one
                raise ConfigurationError(f"{self.name}: {missing}", "", f"a value: {one} and {other} belong together")
        if self.cert_file and not self.ca_file:
            raise ConfigurationError(f"{self.name}: ca_file", "", "the broker's CA: a client certificate needs TLS")

    def password(self) -> str:
        """Return the password; ConfigurationError when it cannot be read, or others can read it too."""
        _refuse_shared(self.password_file)
        lines = _read(self.password_file).splitlines()
        if not lines or not lines[0]:
            raise ConfigurationError(self.password_file, "", "the password in the first line")
        return lines[0]

    def context(self) -> ssl.SSLContext:
        """Return what makes a TLS connection: TLS 1.2 or newer, the broker's chain and host name checked."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        # a renegotiation would make reads wait for writes and writes for reads
        context.options |= ssl.OP_NO_RENEGOTIATION
        _load(self.ca_file, context.load_verify_locations, "PEM certificates of the broker's CA")
        if self.cert_file:
            _refuse_shared(self.key_file)
            _load(self.cert_file, context.load_cert_chain, "a PEM certificate that fits its key", self.key_file)
        return context


def load_account(path: str | Path) -> Account:
    """Read an account file; return it with absolute paths, or raise ConfigurationError."""
    path = Path(path).expanduser()
    try:
        document = json.loads(_read(path))
    except ValueError as error:
        raise ConfigurationError(str(path), str(error), "a JSON object, as make_site writes it") from error
    keys = {field.name for field in fields(Account)} - {"name"}
    if not isinstance(document, dict) or not set(document) <= keys:
        raise ConfigurationError(str(path), document, f"a JSON object of {', '.join(sorted(keys))}")
    if not all(isinstance(value, str) for value in document.values()):
        raise ConfigurationError(str(path), document, "texts as values")
    named = {key: value for key, value in document.items() if key.endswith("_file") and value}
    files = {key: str(path.parent.absolute() / value) for key, value in named.items()}
    return Account(**(document | files), name=str(path))


def _read(path: str | Path) -> str:
    try:
        with open(path, encoding="utf-8") as file:
            text = file.read(_MAX_BYTES + 1)
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(str(path), getattr(error, "strerror", str(error)), "a readable text file") from error
    if len(text) > _MAX_BYTES:
        raise ConfigurationError(str(path), f"more than {_MAX_BYTES} characters", "a short text file")
    return text


def _refuse_shared(path: str) -> None:
    if os.name != "posix":
        return
    try:
        mode = stat.S_IMODE(os.stat(path).st_mode)
    except OSError as error:
        raise ConfigurationError(path, error.strerror, "a file that this user may read") from error
    if mode & 0o077:
        raise ConfigurationError(path, f"mode {mode:04o}", f"a secret that only its owner may read: chmod 600 {path}")


def _load(path: str, load, expected: str, *more: str) -> None:
    try:
        load(path, *more)
    except ssl.SSLError as error:
        raise ConfigurationError(path, error.reason or str(error), expected) from error
    except OSError as error:
        raise ConfigurationError(" or ".join((path, *more)), error.strerror, "a file this user may read") from error
