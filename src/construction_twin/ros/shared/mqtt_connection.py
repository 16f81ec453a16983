"""What the nodes that speak MQTT have in common: their parameters, and reports on the connection."""

from __future__ import annotations

import pydantic
import rospy

from construction_twin.mqtt.account import load_account
from construction_twin.mqtt.client import Broker
from construction_twin.mqtt.failures import ConnectionReport
from construction_twin.ros.shared.params import NodeSettings


class MqttSettings(NodeSettings):
    """Where the broker is, and which account to use; given in launch/link.launch.

    Attributes
    ----------
    host : str
    port : int
    protocol : str
        ``5`` or ``3.1.1``.
    prefix : str
        First level of the topics.
    account : str
        Account file on this machine; empty: anonymous, without TLS. No secret is ever a parameter.
    """

    host: str
    port: int = pydantic.Field(gt=0, lt=65536)
    protocol: str = "5"
    prefix: str = "twin"
    account: str = ""


def broker_of(settings: MqttSettings) -> Broker:
    """Return the broker; ConfigurationError when the account file cannot be used."""
    account = load_account(settings.account) if settings.account else None
    return Broker(settings.host, settings.port, settings.protocol, account=account)


def report_of(broker: Broker) -> ConnectionReport:
    """Return a report that goes to the node's log."""
    return ConnectionReport(broker, lambda sentence: rospy.logerr("%s", sentence))
