"""Who gets into a site's broker and who does not, and what each failure says. The real mosquitto, the package's own client."""

from __future__ import annotations

import socket
import ssl
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from processes import BrokerProcess, wait_until
from site_broker import Listener, SiteBroker

from construction_twin.broker.make_site import run_tool, sign_authority, write_private
from construction_twin.gateway.config import GatewayConfig
from construction_twin.mqtt.client import Account, Broker, ConnectionLog, make_client, unique_id


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    site = SiteBroker(tmp_path_factory.mktemp("site"))
    site.start()
    yield site
    site.stop()


class Attempt:
    """A client that tries to connect as the nodes do, and what it reports."""

    def __init__(self, broker: Broker):
        self.said: list[str] = []
        self.welcome = False
        report = ConnectionLog(broker, self.said.append)
        self.client = make_client(broker, unique_id("one", "attempt"), "unused/attempt")
        report.watch(self.client)
        self.client.on_connect = lambda c, u, f, code, p: (
            report.refused(code) if code.is_failure else self._welcomed(report, c, p)
        )
        self.client.on_disconnect = lambda c, u, f, code, p: report.lost(code)
        self.client.connect_async(broker.host, broker.port, broker.keepalive)

    def _welcomed(self, report: ConnectionLog, *answer) -> None:
        self.welcome = True
        report.connected(*answer)

    def __enter__(self) -> Attempt:
        self.client.loop_start()
        return self

    def __exit__(self, *_) -> None:
        self.client.disconnect()
        self.client.loop_stop()


def refusal(broker: Broker) -> str:
    """Return the one sentence with which a connection fails."""
    with Attempt(broker) as attempt:
        wait_until(lambda: attempt.said, what="a sentence")
        assert not attempt.welcome
    return attempt.said[0]


# -- in


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1"])
def test_an_account_of_the_site_gets_in(site, host):
    with Attempt(site.broker(site.account("one-gateway"), host)) as attempt:
        wait_until(lambda: attempt.welcome, what="the broker's welcome")
        assert attempt.client.socket().version() in ("TLSv1.2", "TLSv1.3")
    assert attempt.said == []


def test_the_certificates_stand_the_strictest_check(site):
    context = site.account("one-gateway").context()
    context.verify_flags |= ssl.VERIFY_X509_STRICT
    with socket.create_connection(("localhost", site.site.port)) as plain:
        with context.wrap_socket(plain, server_hostname="localhost") as line:
            assert line.getpeercert()["subjectAltName"] == (("DNS", "localhost"), ("IP Address", "127.0.0.1"))


# -- out


def test_nobody_is_anonymous(site):
    ca_file = site.account("one-gateway").ca_file
    assert "refused a client without an account: Not authorized" in refusal(site.broker(Account(ca_file=ca_file)))


def test_a_wrong_password_is_refused_and_not_told(site, tmp_path):
    path = tmp_path / "password"
    write_private(path, "guessed-secret\n")
    account = replace(site.account("one-gateway"), password_file=str(path))
    sentence = refusal(site.broker(account))
    assert "refused user 'one-gateway'" in sentence and "guessed-secret" not in sentence


def test_an_unknown_user_is_refused(site):
    account = replace(site.account("one-gateway"), user="nobody")
    assert "'nobody'" in refusal(site.broker(account))


def test_the_password_of_one_account_does_not_open_another(site):
    account = replace(site.account("vic"), user="one-bridge")
    assert "'one-bridge'" in refusal(site.broker(account))


def test_plain_tcp_is_refused_on_the_tls_port(site):
    with Attempt(Broker(port=site.site.port)) as attempt:
        wait_until(lambda: attempt.said, what="a sentence")
        assert not attempt.welcome and "lost: " in attempt.said[0]


def test_a_broker_of_another_ca_is_not_believed(site, tmp_path):
    sign_authority(tmp_path / "foreign", ["localhost"])
    account = replace(site.account("one-gateway"), ca_file=str(tmp_path / "foreign.crt"))
    assert "unable to get local issuer certificate" in refusal(site.broker(account))


def test_a_broker_by_another_name_is_not_believed(site):
    assert "Hostname mismatch" in refusal(site.broker(site.account("one-gateway"), "127.1"))


def expire(certificate: Path, key: Path, ca: Path) -> None:
    """Sign a certificate anew, for the same key, so that it ends at once."""
    extensions = ("-copy_extensions", "copyall")
    request = certificate.with_name("request")
    request.write_text(run_tool("openssl", "x509", "-x509toreq", "-in", certificate, "-key", key, *extensions))
    signer = ("-CA", ca / "ca.crt", "-CAkey", ca / "ca.key", "-set_serial", "1")
    write_private(certificate, run_tool("openssl", "x509", "-req", "-in", request, *extensions, *signer, "-days", "0"))


def test_an_expired_broker_is_not_believed(tmp_path):
    site = SiteBroker(tmp_path / "site")
    server = tmp_path / "site/broker"
    expire(server / "server.crt", server / "server.key", tmp_path / "site/ca")
    site.start()
    try:
        assert "certificate has expired" in refusal(site.broker(site.account("one-gateway")))
    finally:
        site.stop()


# -- what is said


def test_a_failure_that_repeats_is_said_once_until_it_changes():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        broker = Broker(port=probe.getsockname()[1])
    said: list[str] = []
    report = ConnectionLog(broker, said.append)
    for _ in range(3):
        report.failed(ConnectionRefusedError(111, "Connection refused"))
    report.failed(TimeoutError("timed out"))
    report.connected(make_client(broker, "id", "status"), None)
    assert report.sentence == ""
    report.failed(ConnectionRefusedError(111, "Connection refused"))
    assert [("refused" in sentence, "timed out" in sentence) for sentence in said] == [
        (True, False),
        (False, True),
        (True, False),
    ]


def test_a_program_with_the_account_of_another_role_says_that_it_may_not_publish(site):
    said: list[str] = []
    broker = site.broker(site.account("vic"))
    report = ConnectionLog(broker, said.append)
    client = make_client(broker, unique_id("one", "wrong"), "twin/one/status")

    def on_connect(client, *_):
        report.watch_publish(client, "twin/one/status", client.publish("twin/one/status", b"{}", qos=1).mid)

    client.on_connect = on_connect
    client.connect(broker.host, broker.port)
    client.loop_start()
    try:
        wait_until(lambda: said, what="a sentence")
    finally:
        client.disconnect()
        client.loop_stop()
    assert "does not let vic publish on twin/one/status" in said[0] and client.on_publish is None


# -- the gateway as it is started on the cell PC


def run_gateway(site, tmp_path, name: str, host: str = "localhost") -> subprocess.Popen:
    config = tmp_path / "one.json"
    config.write_text(GatewayConfig("one", ("A1",), (-0.5,), (0.5,), (2.0,), (2.34,)).to_json())
    account = site.folder / "accounts" / name / "account.json"
    options = ["--config", str(config), "--account", str(account), "--broker", f"{host}:{site.site.port}"]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        options += ["--listen", f"127.0.0.1:{probe.getsockname()[1]}"]
    command = [sys.executable, "-m", "construction_twin.gateway", *options]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True)


def test_the_gateway_s_program_tells_its_status_through_tls_and_ends_with_its_last_words(site, tmp_path):
    viewer = Listener(site.broker(site.account("vic")), "twin/one/status", "viewer")
    process = run_gateway(site, tmp_path, "one-gateway")
    try:
        wait_until(
            lambda: any(b"no_controller" in payload for _, payload in viewer.messages), 30.0, "the gateway's status"
        )
        process.terminate()
        wait_until(lambda: b"gateway stopped" in viewer.messages[-1][1], what="the last words")
        assert process.wait(10.0) == 0
    finally:
        process.kill()
        process.communicate()
        viewer.close()


# -- the demo's broker


def listening(port: int) -> set[str]:
    """Return the local addresses, as the kernel writes them, on which this machine listens for TCP on a port."""
    found = set()
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in Path(table).read_text().splitlines()[1:]:
            _, local, _, state, *_ = line.split()
            address, number = local.split(":")
            if state == "0A" and int(number, 16) == port:
                found.add(address)
    return found


LOOPBACK = {"0100007F", "00000000000000000000000001000000"}


def test_the_demo_s_broker_listens_on_loopback_only(broker):
    assert listening(broker) and listening(broker) <= LOOPBACK


def test_the_demo_s_configuration_alone_opens_nothing_to_a_network(tmp_path):
    """Whoever starts mosquitto with it by hand: without a listener mosquitto stays local."""
    process = BrokerProcess()
    process.start()
    try:
        assert listening(process.port) <= LOOPBACK
    finally:
        process.kill()
