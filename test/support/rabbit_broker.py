"""RabbitMQ as an MQTT broker on loopback, where Debian's rabbitmq-server is installed; it knows no MQTT 5 before 3.13."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import tempfile
from pathlib import Path

from processes import listens, wait_until

#: The program itself: the one in /usr/sbin writes into the system's folders.
PROGRAM = Path("/usr/lib/rabbitmq/bin/rabbitmq-server")
USER = "rabbitmq"


def is_installed() -> bool:
    """Return whether this machine can run one: the program refuses other users than its own, so root must become that one."""
    return PROGRAM.exists() and shutil.which("setpriv") is not None and os.geteuid() == 0


def free_ports(count: int) -> list[int]:
    """Return some free TCP ports of the loopback interface."""
    probes = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    ports = [probe.getsockname()[1] for probe in probes]
    for probe in probes:
        probe.close()
    return ports


class RabbitBroker:
    """A RabbitMQ with its MQTT plugin, in a folder of its own; it and its port mapper end with `kill`."""

    def __init__(self):
        self.port, distribution, self._mapper = free_ports(3)
        self._folder = Path(tempfile.mkdtemp(prefix="rabbit"))
        (self._folder / "rabbitmq.conf").write_text(
            f"listeners.tcp = none\nmqtt.listeners.tcp.1 = 127.0.0.1:{self.port}\nmqtt.allow_anonymous = true\n"
            "mqtt.tcp_listen_options.nodelay = true\n"
        )
        (self._folder / "enabled_plugins").write_text("[rabbitmq_mqtt].\n")
        shutil.chown(self._folder, USER)
        folder = str(self._folder)
        self._environment = {
            "PATH": os.environ["PATH"],
            "HOME": folder,
            "RABBITMQ_NODENAME": f"twin{self.port}@localhost",
            "RABBITMQ_CONFIG_FILE": f"{folder}/rabbitmq.conf",
            "RABBITMQ_ENABLED_PLUGINS_FILE": f"{folder}/enabled_plugins",
            "RABBITMQ_MNESIA_BASE": f"{folder}/mnesia",
            "RABBITMQ_LOG_BASE": f"{folder}/log",
            "RABBITMQ_DIST_PORT": str(distribution),
            "RABBITMQ_SERVER_ADDITIONAL_ERL_ARGS": "-kernel inet_dist_use_interface {127,0,0,1}",
            "ERL_EPMD_PORT": str(self._mapper),
            "ERL_EPMD_ADDRESS": "127.0.0.1",
        }
        self._process: subprocess.Popen | None = None

    def start(self) -> None:
        self._process = subprocess.Popen(
            ["setpriv", f"--reuid={USER}", f"--regid={USER}", "--clear-groups", str(PROGRAM)],
            env=self._environment,
            cwd=self._folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        wait_until(lambda: listens(self.port), 90.0, "RabbitMQ listening")

    def kill(self) -> None:
        """End it, and the port mapper that it has started."""
        if self._process is not None:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait(10.0)
            self._process = None
        mapper = {"ERL_EPMD_PORT": str(self._mapper), "PATH": os.environ["PATH"]}
        wait_until(
            lambda: (
                subprocess.run(["epmd", "-kill"], env=mapper, capture_output=True).returncode == 0
                or not listens(self._mapper)
            ),
            what="the end of RabbitMQ's port mapper",
        )
        shutil.rmtree(self._folder, ignore_errors=True)
