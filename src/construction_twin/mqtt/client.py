"""A paho client set up the way this package needs it: MQTT 5, account, TLS, TCP_NODELAY, a last will.

Without TCP_NODELAY, traffic in both directions waits for the peer's delayed acknowledgement, up to 40 ms. An account file holds
names of files, never a secret; relative names start at its own folder::

    {"user": "kr120-gateway", "ca_file": "ca.crt", "password_file": "password"}
    {"ca_file": "ca.crt", "cert_file": "client.crt", "key_file": "client.key"}
"""

from __future__ import annotations

import json
import os
import secrets
import socket
import ssl
import stat
from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from paho.mqtt import client as paho
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.subscribeoptions import SubscribeOptions

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.network import is_loopback
from construction_twin.mqtt.fast_client import DirectClient, FastClient, check_paho

#: An account file, and a password file, are short; anything longer is something else [bytes].
_MAX_BYTES = 65536


@dataclass(frozen=True)
class Account:
    """An account on a broker: a user with a password, or a client certificate. Empty means none.

    Attributes:
        password_file: The password is its first line; only the owner may read it.
        ca_file: PEM of who signed the broker's certificate; with it the connection is TLS.
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
    """Read an account file; return it with absolute paths, or raise ConfigurationError, also where a secret cannot be used."""
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
    account = Account(**(document | files), name=str(path))
    if account.password_file:
        account.password()
    if account.ca_file:
        account.context()
    return account


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


@dataclass(frozen=True)
class Broker:
    """Where the broker is; no account: anonymous. ConfigurationError for an untested paho, or a password in clear."""

    host: str = "127.0.0.1"
    port: int = 1883
    keepalive: int = 5
    account: Account | None = None

    def __post_init__(self):
        check_paho()
        if self.account is not None and not self.encrypted and not is_loopback(self.host):
            expected = f"the CA of {self.host}'s certificate: a password crosses a network in TLS only"
            raise ConfigurationError(f"{self.account.name}: ca_file", "", expected)

    @property
    def encrypted(self) -> bool:
        """True when the connection is TLS."""
        return self.account is not None and bool(self.account.ca_file)


def unique_id(robot: str, role: str) -> str:
    """Return a client id that cannot be guessed: a client that connects with another one's id takes its connection away."""
    return f"{robot}-{role}-{secrets.token_hex(8)}"


#: What the broker says in a client's place when its connection is lost.
OFFLINE = json.dumps({"state": "offline", "reason": "connection lost"})


def offline_word(run: str, connection: int) -> str:
    """Return `OFFLINE` of a run of the client's program and one of its connections: a broker may notice late that one is lost."""
    return json.dumps({"state": "offline", "reason": "connection lost", "run": run, "connection": connection})


def make_client(
    broker: Broker,
    client_id: str,
    will_topic: str,
    will: str = OFFLINE,
    direct: bool = False,
    will_retained: bool = True,
) -> FastClient:
    """Return a client that is not connected yet.

    Args:
        will: What the broker publishes on `will_topic` when the connection is lost; empty: its retained message is taken away.
        direct: Send from the thread that publishes, where there is no TLS; for a client served by `loop_start`.
    """
    kind = DirectClient if direct and not broker.encrypted else FastClient
    client = kind(CallbackAPIVersion.VERSION2, client_id=client_id, protocol=MQTTProtocolVersion.MQTTv5)
    client.will_set(will_topic, will, qos=1, retain=will_retained)
    # the same on a TLS socket: it hands the option to the TCP socket below
    client.on_socket_open = _without_delay
    client.reconnect_delay_set(min_delay=1, max_delay=2)
    if broker.account is not None and broker.account.user:
        client.username_pw_set(broker.account.user, broker.account.password())
    if broker.account is not None and broker.encrypted:
        client.tls_set_context(broker.account.context())
    return client


def _without_delay(client: paho.Client, userdata: object, sock: Any) -> None:
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


def subscriptions(topics: Iterable[tuple[str, int]]) -> list[tuple[str, SubscribeOptions]]:
    """Return topics and their QoS in the form that `client.subscribe` takes, so that a retain flag stays visible.

    Without "retain as published" a broker shows the flag only on what it had stored, not on what is published while we listen.
    """
    return [(topic, SubscribeOptions(qos=qos, retainAsPublished=True)) for topic, qos in topics]
