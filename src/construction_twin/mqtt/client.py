"""A paho client set up for this package: MQTT 5, account, TLS, TCP_NODELAY, a last will; why it has no connection.

An account file holds names of files, never a secret; relative names start at its own folder::

    {"user": "kr120-gateway", "ca_file": "ca.crt", "password_file": "password"}
"""

from __future__ import annotations

import json
import os
import secrets
import socket
import ssl
import stat
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from paho.mqtt import client as paho
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.files import read_file
from construction_twin.core.network import is_loopback
from construction_twin.mqtt.fast_client import DirectClient, FastClient, check_paho

#: Longest account file and password file [bytes].
_MAX_BYTES = 65536


@dataclass(frozen=True)
class Account:
    """An account on a broker; empty: none.

    Attributes:
        password_file: The password is its first line; only the owner may read it.
        ca_file: PEM of who signed the broker's certificate; with it the connection is TLS.
        name: The account file, for messages.
    """

    user: str = ""
    password_file: str = ""
    ca_file: str = ""
    name: str = "account"

    def __post_init__(self):
        if bool(self.user) != bool(self.password_file):
            missing = "password_file" if self.user else "user"
            raise ConfigurationError(f"{self.name}: {missing}", "", "a value: user and password_file belong together")

    def password(self) -> str:
        """Read the password; ConfigurationError for a file that is unreadable, or readable by others."""
        _refuse_shared(self.password_file)
        lines = _read(self.password_file).splitlines()
        if not lines or not lines[0]:
            raise ConfigurationError(self.password_file, "", "the password in the first line")
        return lines[0]

    def context(self) -> ssl.SSLContext:
        """Return the TLS context: TLS 1.2 or newer, the broker's chain and host name checked."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        # a renegotiation would make reads wait for writes and writes for reads
        context.options |= ssl.OP_NO_RENEGOTIATION
        try:
            context.load_verify_locations(self.ca_file)
        except ssl.SSLError as error:
            found = error.reason or str(error)
            raise ConfigurationError(self.ca_file, found, "PEM certificates of the broker's CA") from error
        except OSError as error:
            raise ConfigurationError(self.ca_file, error.strerror, "a file this user may read") from error
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
        return read_file(path, _MAX_BYTES).decode()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(str(path), getattr(error, "strerror", str(error)), "a short text file") from error


def _refuse_shared(path: str) -> None:
    if os.name != "posix":
        return
    try:
        mode = stat.S_IMODE(os.stat(path).st_mode)
    except OSError as error:
        raise ConfigurationError(path, error.strerror, "a file that this user may read") from error
    if mode & 0o077:
        raise ConfigurationError(path, f"mode {mode:04o}", f"a secret that only its owner may read: chmod 600 {path}")


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
    """Return a random client id: a second client with the same id would take over the connection."""
    return f"{robot}-{role}-{secrets.token_hex(8)}"


#: Last will of a client.
OFFLINE = json.dumps({"state": "offline", "reason": "connection lost"})


def last_will(run: str, connection: int) -> str:
    """Return a last will with run and connection, by which a late one is known."""
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
        will: Empty: the retained message on `will_topic` is deleted.
        direct: Send from the thread that publishes, where there is no TLS; for a client served by `loop_start`.
    """
    kind = DirectClient if direct and not broker.encrypted else FastClient
    client = kind(CallbackAPIVersion.VERSION2, client_id=client_id, protocol=MQTTProtocolVersion.MQTTv5)
    client.will_set(will_topic, will, qos=1, retain=will_retained)
    # else traffic in both directions waits for the peer's delayed acknowledgement, up to 40 ms
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
    """Return topics and QoS for `client.subscribe`, with retain flags as published."""
    return [(topic, SubscribeOptions(qos=qos, retainAsPublished=True)) for topic, qos in topics]


class ConnectionLog:
    """Logs why there is no connection, each sentence once, from the thread that connects or serves the client.

    Args:
        first: Whether to log why there has never been a connection.

    Attributes:
        sentence: The newest; "" while connected, and before the first attempt has ended.
    """

    def __init__(self, broker: Broker, log: Callable[[str], None], first: bool = True):
        self._log, self._is_logging = log, first
        self._where, self._user = f"broker {broker.host}:{broker.port}", broker.account.user if broker.account else ""
        self.sentence = ""

    def watch(self, client: paho.Client) -> None:
        """Log the failed attempts of a client that paho's own thread serves."""

        def failed(client, userdata) -> None:
            error = sys.exc_info()[1]
            if isinstance(error, OSError):
                self.failed(error)

        client.on_connect_fail = failed

    def connected(self, client: FastClient, properties: Properties | None) -> None:
        """Clear the sentence; `properties` of the CONNACK limit the packets."""
        self._is_logging, self.sentence = True, ""
        client.largest = getattr(properties, "MaximumPacketSize", None)
        client.on_too_large = self._log

    def failed(self, error: OSError) -> None:
        """Log an attempt to connect that raised an error, also of TLS or name resolution."""
        why = getattr(error, "verify_message", "") or error.strerror or str(error) or repr(error)
        self._log_once(f"{self._where}: {why}")

    def refused(self, reason_code: ReasonCode) -> None:
        """Log a connection that the broker refused in its CONNACK."""
        who = f"user {self._user!r}" if self._user else "a client without an account"
        self._log_once(f"{self._where} refused {who}: {reason_code}")

    def lost(self, reason_code: ReasonCode) -> None:
        """Log the unwanted end of a connection; why it was refused stays."""
        if reason_code.is_failure and not self.sentence:
            self._log_once(f"connection to {self._where} lost: {reason_code}; trying again")

    def watch_publish(self, client: paho.Client, topic: str, mid: int) -> None:
        """Log when the access rules refuse one message; one only, because a callback for each would slow down commands."""

        def on_publish(client, userdata, answered, reason_code, properties) -> None:
            if answered != mid:
                return
            client.on_publish = None
            if reason_code.is_failure:
                who = self._user or "somebody without an account"
                self._log(f"{self._where} does not let {who} publish on {topic}: {reason_code}")

        client.on_publish = on_publish

    def _log_once(self, sentence: str) -> None:
        if sentence != self.sentence:
            self.sentence = sentence
            if self._is_logging:
                self._log(sentence)
