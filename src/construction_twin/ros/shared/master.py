"""The ROS master, and the nodes that run on it, asked in bounded time: a master that does not answer is one sentence."""

from __future__ import annotations

import http.client
import sys
import time
import urllib.parse
import xmlrpc.client
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import rosgraph

from construction_twin.core.errors import ConfigurationError, SilenceError

#: How long a command waits for the master [s].
TIMEOUT = 5.0
#: How long a node may take to say that it lives [s].
NODE_TIMEOUT = 2.0
#: The same for a command's two questions to a node without which it can do nothing: in all less than a second [s].
ANSWER = 0.4
#: What to do when there is none.
TO_DO = "start bringup, or set ROS_MASTER_URI"
#: The parameter by which ROS takes its time from the topic /clock.
SIMULATED = "/use_sim_time"
#: How often a master that does not answer is asked again [s].
_POLL = 0.5
_CALLER = "/construction_twin"
#: What a call may end with when there is no master, or another program on its port.
FAILURES = (OSError, ValueError, http.client.HTTPException, xmlrpc.client.Error)


@dataclass(frozen=True)
class RunningNode:
    """A node that is registered; `pid` None: it does not answer."""

    name: str
    host: str
    pid: int | None

    def __str__(self) -> str:
        if self.pid is None:
            return f"{self.name} on {self.host} (does not answer; if it has ended, `rosnode cleanup` removes it)"
        return f"{self.name} on {self.host}, process {self.pid}"


class _Transport(xmlrpc.client.Transport):
    """XML-RPC that gives up."""

    def __init__(self, timeout: float):
        super().__init__()
        self._timeout = timeout

    def make_connection(self, host) -> http.client.HTTPConnection:
        """Return a connection that waits for an answer no longer than this transport's time limit."""
        connection = super().make_connection(host)
        connection.timeout = self._timeout
        return connection


def ask(uri: str, timeout: float, question: str, *words: str) -> tuple[int, Any]:
    """Return code and value of a call of ROS's XML-RPC interfaces; raises one of `FAILURES`."""
    with xmlrpc.client.ServerProxy(uri, transport=_Transport(timeout)) as proxy:
        answer: Any = getattr(proxy, question)(_CALLER, *words)
    if not isinstance(answer, list) or len(answer) != 3:
        raise ValueError(f"{uri} answers {question} with {answer!r:.60}, which is not ROS")
    code, _, value = answer
    return code, value


def await_master(timeout: float = TIMEOUT) -> None:
    """Return when the master has answered; ConfigurationError for no address, SilenceError after `timeout` [s]."""
    uri = rosgraph.get_master_uri()
    address = urllib.parse.urlsplit(uri)
    if address.scheme != "http" or not address.hostname:
        raise ConfigurationError("ROS_MASTER_URI", uri, "http://HOST:PORT")
    try:
        ask(uri, timeout, "getPid")
    except FAILURES as error:
        problem = f"no ROS master answers ({error})"
        raise SilenceError(uri, problem, TO_DO) from error


def wait_for_master(name: str) -> None:
    """Return when the master answers, saying once that this takes longer; ConfigurationError where ROS_MASTER_URI is no address."""
    printed = False
    while True:
        try:
            return await_master()
        except SilenceError as error:
            if not printed:
                print(f"{name} waits: {error}", file=sys.stderr, flush=True)
            printed = True
        time.sleep(_POLL)


def expect_wall_clock(uri: str) -> None:
    """Raise ConfigurationError where a master gives simulated time, by /use_sim_time; without a master there is none."""
    try:
        _, is_simulated = ask(uri, TIMEOUT, "getParam", SIMULATED)
    except FAILURES:
        return
    if is_simulated is True:
        to_do = "rosparam set use_sim_time false, or start on another master (roslaunch -p 11312)"
        raise ConfigurationError(SIMULATED, True, f"false: the twin and the arm go by this machine's clock; {to_do}")


def publishing_nodes(topic: str) -> list[str]:
    """Return the nodes that the master knows to publish a topic, given as an absolute name; SilenceError without a master."""
    uri = rosgraph.get_master_uri()
    try:
        _, (publishers, _, _) = ask(uri, TIMEOUT, "getSystemState")
    except FAILURES as error:
        raise SilenceError(uri, f"no ROS master answers ({error})", TO_DO) from error
    return [name for published, nodes in publishers if published == topic for name in nodes]


def expect_publisher(topic: str, patience: float = ANSWER) -> None:
    """Return when a node that publishes a topic answers; SilenceError where none is registered, or answers."""
    names = publishing_nodes(topic)
    # twice, because a machine under load may lose a question
    answers = (node.pid for _ in range(2) for node in running(names, rosgraph.get_master_uri(), patience))
    if not any(answers):
        who = " and ".join(names)
        problem = f"{who} has ended, or does not answer" if names else "no node publishes it"
        raise SilenceError(topic, problem, "start bringup, or see why the node is down")


def running(names: Iterable[str], uri: str, patience: float = NODE_TIMEOUT) -> list[RunningNode]:
    """Return which nodes run now, each asked, because one that was killed stays registered; none when there is no master."""
    try:
        found = {name: ask(uri, TIMEOUT, "lookupNode", name) for name in names}
    except FAILURES:
        return []
    nodes = (_query_node(name, str(address), patience) for name, (code, address) in found.items() if code == 1)
    return [node for node in nodes if node is not None]


def _query_node(name: str, address: str, patience: float) -> RunningNode | None:
    host = urllib.parse.urlsplit(address).hostname or address
    try:
        _, pid = ask(address, patience, "getPid")
        try:
            code, answered_name = ask(address, patience, "getName")
        except xmlrpc.client.Fault:
            code, answered_name = -1, ""  # roscpp has no such question
    except ConnectionRefusedError:
        return None
    except FAILURES:
        return RunningNode(name, host, None)
    if code == 1 and answered_name != name:
        return None
    return RunningNode(name, host, int(pid))
