"""MQTT in nodes: parameters, connection, and reports on it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence

import pydantic
import rospy
from paho.mqtt.client import MQTTMessage

from construction_twin.mqtt.client import Broker, ConnectionLog, load_account, subscriptions
from construction_twin.mqtt.fast_client import FastClient
from construction_twin.robot.description import RobotModel
from construction_twin.ros.shared.node_shell import Shared
from construction_twin.ros.shared.params import NodeSettings
from construction_twin.ros.shared.start_refusal import launch_id

#: How long a node waits before it says that the broker is gone [s]: one Ctrl-C ends both, and the broker is often first.
GRACE = 1.0


class MqttSettings(NodeSettings):
    """Where the broker is, and the account file (empty: anonymous, without TLS); `prefix`: first level of the topics."""

    host: str
    port: int = pydantic.Field(gt=0, lt=65536)
    prefix: str = "twin"
    account: str = ""


def broker_of(settings: MqttSettings) -> Broker:
    """Return the broker; ConfigurationError when the account file cannot be used."""
    account = load_account(settings.account) if settings.account else None
    return Broker(settings.host, settings.port, account=account)


def check_broker(settings: MqttSettings, _robot: RobotModel, _shared: Shared) -> None:
    """Check the account; see `NodeShell`."""
    broker_of(settings)


def connection_log(broker: Broker) -> ConnectionLog:
    """Return a log that writes to the node's, in a thread that may wait for a disk; in a launch `startup` logs the first."""
    return ConnectionLog(broker, _log_later, first=not launch_id())


def _log_later(sentence: str) -> None:
    timer = threading.Timer(GRACE, lambda: rospy.is_shutdown() or rospy.logerr("%s", sentence))
    timer.daemon = True
    timer.start()


def connect(
    client: FastClient,
    broker: Broker,
    log: ConnectionLog,
    topics: Sequence[tuple[str, int]],
    first: Callable[[], tuple[str, bytes, bool]],
    on_message: Mapping[str, Callable[[MQTTMessage], None]],
    then: Callable[[], object] = lambda: None,
    lost: Callable[[], object] = lambda: None,
) -> None:
    """Connect to the broker, and serve the connection in a thread of its own, which makes all the calls.

    Args:
        topics: What is subscribed, with its QoS.
        first: Returns topic, payload and retain flag of the first message, whose answer shows if this account may write here.
        then, lost: Called with the connection there, and gone.
    """

    def on_connect(client, _userdata, _flags, reason_code, properties) -> None:
        if reason_code.is_failure:
            log.refused(reason_code)
            return
        log.connected(client, properties)
        topic, payload, retain = first()
        client.subscribe(subscriptions(topics))
        info = client.publish(topic, payload, qos=1, retain=retain)
        log.watch_publish(client, topic, info.mid)
        then()

    def on_disconnect(_client, _userdata, _flags, reason_code, _properties) -> None:
        log.lost(reason_code)
        lost()

    log.watch(client)
    client.on_connect = on_connect
    client.on_disconnect = on_disconnect
    for topic, handler in on_message.items():
        client.message_callback_add(topic, _message_only(handler))
    client.connect_async(broker.host, broker.port, broker.keepalive)
    client.loop_start()


def _message_only(handler: Callable[[MQTTMessage], None]) -> Callable[[object, object, MQTTMessage], None]:
    return lambda _client, _data, message: handler(message)
