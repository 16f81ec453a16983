"""What a client is before it connects: its id, its last will, and that no password leaves in clear."""

from __future__ import annotations

import pytest
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.reasoncodes import ReasonCode

from construction_twin.core.errors import ConfigurationError
from construction_twin.mqtt.client import Account, Broker, ConnectionLog, make_client, unique_id

ACCOUNT = Account(user="x", password_file="/nowhere/password", name="x.json")


def test_client_ids_name_their_robot_and_role_and_cannot_be_guessed():
    ids = {unique_id("kr120", "gateway") for _ in range(100)}
    assert len(ids) == 100 and all(i.startswith("kr120-gateway-") and len(i) >= 30 for i in ids)


@pytest.mark.parametrize("host", ["broker.example", "192.168.1.10", "0.0.0.0", "::", "localhost.example"])
def test_a_password_does_not_cross_a_network_without_tls(host):
    with pytest.raises(ConfigurationError, match=rf"x\.json: ca_file.*the CA of {host}'s certificate: a password"):
        Broker(host, account=ACCOUNT)


@pytest.mark.parametrize("host", ["127.0.0.1", "127.0.0.2", "::1", "localhost"])
def test_on_loopback_a_password_needs_no_tls(host):
    assert not Broker(host, account=ACCOUNT).encrypted


def test_an_account_whose_files_are_missing_makes_no_client():
    with pytest.raises(ConfigurationError, match="/nowhere/password"):
        make_client(Broker(account=ACCOUNT), "id", "a/status")


def test_only_the_watched_answer_counts_and_the_watch_ends_with_it():
    client, refused = make_client(Broker(), "id", "a/status"), []
    report = ConnectionLog(Broker(), refused.append)
    fine, denied = (ReasonCode(PacketTypes.PUBACK, name) for name in ("Success", "Not authorized"))
    for answer, count in ((denied, 1), (fine, 1)):
        report.watch_publish(client, "a/status", 5)
        client.on_publish(client, None, 4, denied, None)
        assert client.on_publish is not None
        client.on_publish(client, None, 5, answer, None)
        assert len(refused) == count and client.on_publish is None
