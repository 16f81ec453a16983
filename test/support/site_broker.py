"""A site as make_site makes it, and the real mosquitto with its configuration, for the tests of security."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path

from paho.mqtt import client as paho
from processes import ROOT, free_port, listens, wait_until

from construction_twin.broker.access import Site
from construction_twin.broker.make_site import make_site
from construction_twin.mqtt.client import Account, Broker, load_account, make_client, unique_id

HOSTS = ("localhost", "127.0.0.1")
ROBOTS = ("one", "two")


class SiteBroker:
    """A site in a folder, and its broker."""

    def __init__(self, folder: Path, **changes):
        self.folder = folder
        settings = {"hosts": HOSTS, "robots": ROBOTS, "plc": True, "listen": "127.0.0.1"}
        settings["persons"] = ("vic:look",)
        self.site = Site(**(settings | {"port": free_port(), "folder": str(folder / "broker")} | changes))
        self.said = make_site(folder, self.site)
        #: What the broker says.
        self.log = folder / "broker.log"
        self._process = None

    def start(self) -> None:
        command = [sys.executable, str(ROOT / "nodes/broker"), "--config", str(self.folder / "broker/mosquitto.conf")]
        with open(self.log, "a") as log:
            self._process = subprocess.Popen(command, stdout=log, stderr=log)
        wait_until(lambda: listens(self.site.port), what=f"mosquitto listening on {self.site.port}")

    def stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait(5.0)
            self._process = None

    def account(self, name: str) -> Account:
        return load_account(self.folder / "accounts" / name / "account.json")

    def broker(self, account: Account | None, host: str = "localhost", **changes) -> Broker:
        """Return where a client finds this broker."""
        return Broker(host, self.site.port, account=account, **changes)


class Listener:
    """A client of the package's own make, served by paho's thread; keeps what it hears and how its publishes were answered."""

    def __init__(self, broker: Broker, subscribe: str, name: str = "test"):
        self.messages: list[tuple[str, bytes]] = []
        self.answers: dict[int, object] = {}
        self._ready = threading.Event()
        self.client = make_client(broker, unique_id(name, "listener"), f"unused/{name}")
        self.client.on_connect = lambda client, *_: client.subscribe(subscribe, 1)
        self.client.on_subscribe = lambda *_: self._ready.set()
        self.client.on_message = self._on_message
        self.client.on_publish = self._on_publish
        self.client.connect(broker.host, broker.port, broker.keepalive)
        self.client.loop_start()
        assert self._ready.wait(10.0), f"{name}: no answer to the subscription"

    def _on_message(self, client, userdata, message: paho.MQTTMessage) -> None:
        self.messages.append((message.topic, message.payload))

    def _on_publish(self, client, userdata, mid, reason_code, properties) -> None:
        self.answers[mid] = reason_code

    def publish(self, topic: str, payload: bytes, retain: bool = False):
        """Publish and return the broker's answer, a reason code."""
        info = self.client.publish(topic, payload, qos=1, retain=retain)
        wait_until(lambda: info.mid in self.answers, what=f"the broker's answer to a message on {topic}")
        return self.answers.pop(info.mid)

    def publish_all(self, payloads: dict[str, bytes]) -> list[int]:
        """Publish a message on each topic; return the broker's answers in their order, as numbers."""
        sent = [self.client.publish(topic, payload, qos=1).mid for topic, payload in payloads.items()]
        wait_until(lambda: self.answers.keys() >= set(sent), what="the broker's answers")
        return [self.answers.pop(mid).value for mid in sent]

    def close(self) -> None:
        self.client.disconnect()
        self.client.loop_stop()
