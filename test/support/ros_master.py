"""A ROS master in this process, and nodes that are registered with it: what a test needs of ROS without roscore."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import contextmanager
from socketserver import ThreadingMixIn
from xmlrpc.server import SimpleXMLRPCServer

import rosgraph
from processes import free_port
from rosmaster.master import Master

#: What every node here says its process is.
PID = 4711


class Server(ThreadingMixIn, SimpleXMLRPCServer):
    """Answers each question in a thread of its own."""

    allow_reuse_address = True
    daemon_threads = True


class Node:
    """A process that has registered as a node: it answers `getPid`, like every node, and `getName`, like those of rospy.

    Args:
        master: URI.
        topic: What it publishes.
        port: Of its own XML-RPC server; 0: any that is free.
        get_pid: Its answer to `getPid`; questions that come meanwhile are answered, too.
    """

    def __init__(
        self,
        master: str,
        name: str,
        topic: str = "/t",
        port: int = 0,
        get_pid: Callable[[str], tuple[int, str, int]] = lambda _caller: (1, "", PID),
    ):
        self.server = Server(("127.0.0.1", port), logRequests=False)
        self.server.register_function(get_pid, "getPid")
        self.server.register_function(lambda _caller: (1, "", name), "getName")
        self._thread = threading.Thread(target=self.server.serve_forever, args=(0.01,))
        self._thread.start()
        uri = f"http://127.0.0.1:{self.server.server_address[1]}"
        rosgraph.Master(name, master).registerPublisher(topic, "std_msgs/String", uri)

    def end(self) -> None:
        """As if it were killed: it stays registered, and its port is closed."""
        self.server.shutdown()
        self._thread.join()
        self.server.server_close()


@contextmanager
def ros_master():
    """Run a master on loopback; yields its URI. ROS_IP must be 127.0.0.1."""
    running = Master(port=free_port())
    running.start()
    try:
        yield running.uri
    finally:
        # rosgraph closes the socket below the server's loop, which then runs without end and takes this process's time
        node = running.master_node
        node.is_shutdown = True
        node.server.shutdown()
        running.stop()
