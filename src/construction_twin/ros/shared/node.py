"""Start and end of every node, and the sentence of a typed error.

An unexpected exception ends the process, in whatever thread it occurs, and roslaunch starts another one: by
`threading.excepthook` in threads, timers, MQTT client and `Subscriber`, by `Service` after its answer.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import TracebackType

import rosgraph
import rospy
from rosgraph.roslogging import RosStreamHandler

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.realtime import release_realtime, request_realtime
from construction_twin.ros.shared.master import await_master, expect_wall_clock, wait_for_master
from construction_twin.ros.shared.start_refusal import expect_no_other, refuse

#: Exit code of a process that an unexpected exception has ended.
UNFORESEEN = 1
#: How long a service that failed has to send its answer [s].
ANSWER_TIME = 0.2
#: How long the last log line may take [s].
WRITE_TIME = 1.0


def run_node(name: str, start: Callable[[], object], refused: Callable[[str], object] = refuse) -> None:
    """Initialise ROS, build the node, and run its `run` in the main thread, or serve; `refused` takes why it cannot start."""
    try:
        wait_for_master(name)
    except ConstructionTwinError as error:
        sys.exit(f"{name} cannot run: {error}")
    with ending_on_signals():
        try:
            try:
                expect_no_other(name)
                rospy.init_node(name, argv=sys.argv, disable_signals=True)
            except ConstructionTwinError as error:
                # under a name that ends no other node
                rospy.init_node(name, argv=sys.argv[:1], anonymous=True, disable_signals=True)
                refused(str(error))
                return
        except rospy.exceptions.ROSInitException:
            # Ctrl-C, or the end of the launch, came meanwhile
            if rospy.core.is_shutdown_requested():
                return
            raise
        try:
            _serve(name, start, refused)
        finally:
            rospy.signal_shutdown("ended")


def _serve(name: str, start: Callable[[], object], refused: Callable[[str], object]) -> None:
    threading.excepthook = end_on_error
    _send_unwritten_lines_to_stderr()
    try:
        try:
            expect_wall_clock(rosgraph.get_master_uri())
            node = start()
        except ConstructionTwinError as error:
            refused(str(error))
            return
        rospy.on_shutdown(release_realtime)
        rospy.loginfo(request_realtime(rospy.get_param("~realtime_priority", 0)))
        if hasattr(node, "run"):
            node.run()
        else:
            rospy.spin()
    except ConstructionTwinError as error:
        rospy.logfatal("%s cannot run: %s", rospy.get_name(), error)
        sys.exit(1)
    except rospy.ROSInterruptException:
        return
    except ConnectionError:
        # rospy asks the master for parameters and registrations: one that was killed meanwhile is a sentence
        try:
            await_master()
        except ConstructionTwinError as error:
            sys.exit(f"{name} ends: {error}")
        raise


@contextmanager
def ending_on_signals() -> Iterator[None]:
    """Have SIGINT and SIGTERM shut ROS down from a thread of its own, from before `rospy.init_node` to the node's end.

    rospy's own handler unregisters the node in the midst of what the main thread does, and waits for its locks.
    """
    signals, to_signals = os.pipe()

    def shut_down() -> None:
        while number := os.read(signals, 1)[0]:
            rospy.signal_shutdown(f"signal-{number}")

    # a handler may interrupt any line: it takes no lock
    before = {
        number: signal.signal(number, lambda number, _frame: os.write(to_signals, bytes([number])))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    thread = threading.Thread(target=shut_down, name="signals", daemon=True)
    thread.start()
    try:
        yield
    finally:
        os.write(to_signals, b"\0")
        thread.join()
        for number, handler in before.items():
            signal.signal(number, handler)
        os.close(signals)
        os.close(to_signals)


def _send_unwritten_lines_to_stderr() -> None:
    """Send a log line that a full disk refuses to standard error: rosgraph's handler raises it."""
    emit = RosStreamHandler.emit

    def emit_or_handle(self: RosStreamHandler, record: logging.LogRecord) -> None:
        try:
            emit(self, record)
        except OSError:
            self.handleError(record)

    RosStreamHandler.emit = emit_or_handle


def end_on_error(args: threading.ExceptHookArgs) -> None:
    """End the process because of an error in a thread, cleaning nothing up: it may hold a lock. At shutdown only write it down."""
    if args.exc_type is SystemExit:
        return
    where = args.thread.name if args.thread is not None else "a thread that has ended"
    if rospy.core.is_shutdown_requested():
        # topics and sockets are closed below the threads that use them
        _log_exception(where, args.exc_value, "during shutdown")
        return
    # the process ends in any case: also when the line cannot be made, or a log file lies on a disk that hangs
    _exit_after(WRITE_TIME)
    try:
        _log_exception(where, args.exc_value, "this process ends")
    finally:
        os._exit(UNFORESEEN)


class Service(rospy.Service):
    """As `rospy.Service`; a handler that raises is answered with the error, and then the process ends."""

    def __init__(self, name: str, kind: type, handler: Callable):
        super().__init__(name, kind, handler, error_handler=self._end)

    def _end(self, error: Exception, _kind: type, _value: Exception, _trace: TracebackType) -> None:
        if rospy.core.is_shutdown_requested():
            return
        # rospy sends the answer when this returns
        _exit_after(WRITE_TIME)
        try:
            _log_exception(f"service {self.resolved_name}", error, "this process ends")
        finally:
            _exit_after(ANSWER_TIME)


def _exit_after(seconds: float) -> None:
    end = threading.Timer(seconds, os._exit, (UNFORESEEN,))
    end.daemon = True
    end.start()


def _log_exception(where: str, error: BaseException | None, what_follows: str) -> None:
    trace = "".join(traceback.format_exception(error)) if error is not None else ""
    rospy.logfatal("%s: an unexpected exception in %s, %s: %r\n%s", rospy.get_name(), where, what_follows, error, trace)
    sys.stderr.flush()
