"""Why a connection to the broker failed, in one sentence that says what to do. Standard library and paho-mqtt only."""

from __future__ import annotations

import socket
import ssl
import sys
from collections.abc import Callable

from paho.mqtt import client as paho
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from construction_twin.mqtt.client import Broker
from construction_twin.mqtt.fast_client import FastClient

#: OpenSSL's numbers of what is wrong with a certificate (X509_V_ERR_...).
_NOT_YET_VALID, _EXPIRED, _UNKNOWN_CA, _WRONG_NAME = 9, 10, (2, 18, 19, 20, 21), (62, 64)
#: Reason codes that mean the account.
_ACCOUNT = (134, 135)
#: The one that means the version of MQTT; paho makes it of return code 1 too, with which brokers of 3.1.1 refuse MQTT 5.
_UNSUPPORTED_VERSION = 132
#: That a client with the same id has taken the connection away; mosquitto 2.0 does not tell.
_TAKEN_OVER = 142
#: What paho calls a connection that ended without a word of the broker.
_CLOSED = 128


def connection_failure(broker: Broker, error: OSError) -> str:
    """Return the sentence for a connection that was not made, for what connecting raised: of TLS and name resolution, too."""
    if isinstance(error, ssl.SSLCertVerificationError):
        why = f"its certificate {_certificate_failure(broker, error)}"
    elif isinstance(error, ssl.SSLError):
        why = _tls_failure(error)
    elif isinstance(error, socket.gaierror):
        why = f"no such host ({error.strerror}); check the name and the name server"
    elif isinstance(error, ConnectionRefusedError):
        why = "nobody listens there; start the broker, or check host and port"
    elif isinstance(error, TimeoutError):
        why = "no answer; check the cable, the address and the firewall"
    elif isinstance(error, ConnectionResetError):
        why = f"hung up while connecting; does this port speak {'TLS' if broker.encrypted else 'plain TCP'}?"
    else:
        why = error.strerror or str(error)
    return f"broker {broker.host}:{broker.port}: {why}"


def _certificate_failure(broker: Broker, error: ssl.SSLCertVerificationError) -> str:
    if error.verify_code == _EXPIRED:
        return "has expired; renew it with make_site --renew, or check this machine's clock"
    if error.verify_code == _NOT_YET_VALID:
        return "is not valid yet; check the clocks of both machines"
    if error.verify_code in _WRONG_NAME:
        return f"is not for {broker.host!r} ({error.verify_message}); add it with make_site --host"
    if error.verify_code in _UNKNOWN_CA:
        ca_file = broker.account.ca_file if broker.account else ""
        return f"is not signed by the CA in {ca_file} ({error.verify_message}); take ca.crt from its site"
    return f"is refused: {error.verify_message}"


def _tls_failure(error: ssl.SSLError) -> str:
    reason = getattr(error, "reason", None) or str(error)
    if "WRONG_VERSION_NUMBER" in reason or "EOF" in reason:
        return "the port does not speak TLS; give the broker's TLS port, or an account without ca_file"
    if "CERTIFICATE" in reason or "UNKNOWN_CA" in reason:
        return f"the broker refuses this client's certificate ({reason}); take one from this broker's site, or renew it"
    return f"TLS failed ({reason})"


class ConnectionLog:
    """Logs why there is no connection, each sentence once, from the thread that connects or serves the client.

    Args:
        first: Whether to log why there has never been a connection.

    Attributes:
        sentence: Why there is no connection; empty while there is one, and before the first attempt has ended.
    """

    def __init__(self, broker: Broker, log: Callable[[str], None], first: bool = True):
        self._broker, self._log, self._is_logging = broker, log, first
        self._where = f"broker {broker.host}:{broker.port}"
        self._was_accepted = False
        self.sentence = ""

    def watch(self, client: paho.Client) -> None:
        """Log the failed attempts of a client that is served by paho's own thread."""

        def failed(client, userdata) -> None:
            error = sys.exc_info()[1]
            if isinstance(error, OSError):
                self.failed(error)

        client.on_connect_fail = failed

    def connected(self, client: FastClient, properties: Properties | None) -> None:
        """Take note that the broker has accepted the connection, with the properties of its answer (CONNACK)."""
        self._was_accepted = self._is_logging = True
        self.sentence = ""
        client.largest = getattr(properties, "MaximumPacketSize", None)
        client.on_too_large = self._log

    def failed(self, error: OSError) -> None:
        """Log an attempt to connect that raised `error`."""
        self._log_once(connection_failure(self._broker, error))

    def refused(self, reason_code: ReasonCode) -> None:
        """Log a connection that the broker refused in its answer (CONNACK)."""
        where, account = self._where, self._broker.account
        if reason_code.value == _UNSUPPORTED_VERSION:
            self._log_once(f"{where} does not speak MQTT 5: use one that does, as mosquitto (docs/broker.md)")
        elif reason_code.value not in _ACCOUNT:
            self._log_once(f"{where} refused the connection: {reason_code}")
        elif account is None or not account.user:
            self._log_once(f"{where} refused the connection: {reason_code}; it wants an account, give an account file")
        else:
            check = f"check it, and the password in {account.password_file}"
            self._log_once(f"{where} refused user {account.user!r}: {reason_code}; {check}")

    def lost(self, reason_code: ReasonCode) -> None:
        """Log the unwanted end of a connection; what the broker said when it refused one stays."""
        welcomed, self._was_accepted = self._was_accepted, False
        if not reason_code.is_failure or self.sentence:
            return
        broker, where = self._broker, self._where
        # a broker that refuses a client certificate shows itself only here
        certificate = " (if it never lasts: the broker may refuse the client certificate)"
        more = certificate if broker.account is not None and broker.account.cert_file else ""
        if not welcomed:
            spoken = f"MQTT 5 {'with' if broker.encrypted else 'without'} TLS? RabbitMQ before 3.13 does not"
            self._log_once(f"{where} closed the connection without an answer: does the port speak {spoken}{more}")
            return
        if reason_code.value == _TAKEN_OVER:
            why = "taken away by a client with the same id, which an account there knows: see the broker's log (docs/broker.md)"
        else:
            why = f"lost: {'the broker or the network has closed it' if reason_code.value == _CLOSED else reason_code}"
        self._log_once(f"connection to {where} {why}; trying again{more}")

    def watch_publish(self, client: paho.Client, topic: str, mid: int) -> None:
        """Log when the access rules refuse one message that was just published; called in the thread that serves the client.

        One only: a callback for every message would cost time with each command.
        """
        account = self._broker.account
        who = account.user or account.cert_file if account else "somebody without an account"

        def on_publish(client, userdata, answered, reason_code, properties) -> None:
            if answered != mid:
                return
            client.on_publish = None
            if reason_code.is_failure:
                found = f"{self._where} does not let {who} publish on {topic}: {reason_code}"
                self._log(f"{found}; this program needs the account of its role")

        client.on_publish = on_publish

    def _log_once(self, sentence: str) -> None:
        if sentence != self.sentence:
            self.sentence = sentence
            if self._is_logging:
                self._log(sentence)
