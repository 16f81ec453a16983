"""The mock KR C4 on the network: UDP client and 4 ms clock around `mock_controller`. Runs without ROS.

The clock is a grid of absolute deadlines; it never waits for a reply. A real controller is never late, this process can
be: then the packets that are due follow each other by half a cycle until the grid is met again, so that the PC always has
that long to answer, IPOC advances by 4 per packet and keeps up with time. Only after a stall longer than `CATCH_UP` are
grid points given up. Late packets and grid points given up are counted (`overruns`, `skipped`).

    python -m construction_twin.rsi.mock --help
"""

from __future__ import annotations

import argparse
import gc
import logging
import select
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Annotated, Literal, TypeVar

import pydantic

from construction_twin.errors import ConfigurationError, ConstructionTwinError, TransportError
from construction_twin.realtime import request_realtime
from construction_twin.robot import RobotModel, read_robot_files
from construction_twin.rsi.ethernet_xml import load_ethernet_xml, read_ethernet_xml
from construction_twin.rsi.layout import RsiLayout
from construction_twin.rsi.mock_controller import ForwardKinematics, MockConfig, MockController
from construction_twin.rsi.servo import IdealServo, RealisticServo, Servo
from construction_twin.rsi.telegram import MAX_TELEGRAM
from construction_twin.units import CYCLE_NS, NANOSECONDS, degrees, radians

log = logging.getLogger(__name__)

#: Packets that are late by no more than this are all sent [ns].
CATCH_UP = 25 * CYCLE_NS
#: Shortest distance of two packets [ns].
_CLOSEST = CYCLE_NS // 2
#: Datagrams read before the clock is looked at again: a flood must not stop it.
_DRAIN_LIMIT = 64
_ROOT = Path(__file__).resolve().parents[3]

Result = TypeVar("Result")
_Degrees = list[Annotated[float, pydantic.Field(allow_inf_nan=False)]]


class MockSettings(pydantic.BaseModel):
    """What can be set on the mock from outside; config/mock_rsi.yaml explains every key."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    gateway_host: str
    gateway_port: Annotated[int, pydantic.Field(ge=0, le=65535)] = 0
    ethernet_xml: str = ""
    precision: Annotated[int, pydantic.Field(ge=1, le=32)] = 6
    timeout: Annotated[int, pydantic.Field(ge=1)] = 100
    cumulative_delay: bool = False
    start_pose_deg: _Degrees = []
    correction_lower_deg: _Degrees = []
    correction_upper_deg: _Degrees = []
    correction_monitor_deg: _Degrees = []
    velocity_factor: Annotated[float, pydantic.Field(ge=0)] = 2.0
    acceleration_factor: Annotated[float, pydantic.Field(ge=0)] = 400.0
    first_ipoc: Annotated[int, pydantic.Field(ge=0)] = 4_208_163_634
    servo: Literal["ideal", "realistic"] = "ideal"
    servo_delay_cycles: Annotated[int, pydantic.Field(ge=1)] = 3
    servo_omega: Annotated[float, pydantic.Field(gt=0)] = 60.0
    servo_zeta: Annotated[float, pydantic.Field(gt=0)] = 0.8
    encoder_resolution_deg: Annotated[float, pydantic.Field(ge=0)] = 3e-5
    restart_after: Annotated[float, pydantic.Field(ge=0)] = 0.0
    realtime_priority: Annotated[int, pydantic.Field(ge=0, le=99)] = 0


def build_controller(settings: MockSettings, robot: RobotModel) -> MockController:
    """Build the controller of `robot` as `settings` say.

    Raises
    ------
    ConfigurationError
        If a setting does not fit the robot.
    JointRangeError
        If the start pose lies outside the range.
    """
    layout = _layout(settings)
    ends = zip(_to_axes(robot, robot.lower), _to_axes(robot, robot.upper))
    lower, upper = zip(*(sorted(pair) for pair in ends))
    config = MockConfig(
        axes=tuple(axis.rsi for axis in robot.axes),
        start_pose=radians(settings.start_pose_deg) or _to_axes(robot, robot.home),
        lower=lower,
        upper=upper,
        velocity=robot.velocity,
        acceleration=robot.acceleration,
        layout=layout,
        precision=settings.precision,
        timeout=settings.timeout,
        cumulative_delay=settings.cumulative_delay,
        correction_lower=radians(settings.correction_lower_deg) or None,
        correction_upper=radians(settings.correction_upper_deg) or None,
        correction_monitor=radians(settings.correction_monitor_deg) or None,
        velocity_factor=settings.velocity_factor,
        acceleration_factor=settings.acceleration_factor,
        first_ipoc=settings.first_ipoc,
    )
    return MockController(config, build_servo(settings), make_forward_kinematics(robot))


def gateway_address(settings: MockSettings) -> tuple[str, int]:
    """Return where packets go: the port is the Ethernet XML's unless another one is given."""
    layout = _layout(settings)
    if not settings.gateway_port and layout is None:
        raise ConfigurationError("gateway_port", 0, "a port, or an Ethernet XML that names it")
    return settings.gateway_host, settings.gateway_port or layout.port


def _layout(settings: MockSettings) -> RsiLayout | None:
    return read_ethernet_xml(settings.ethernet_xml, "Ethernet XML").layout if settings.ethernet_xml else None


def build_servo(settings: MockSettings) -> Servo:
    """Build the servo model that `settings` name."""
    if settings.servo == "ideal":
        return IdealServo(settings.servo_delay_cycles)
    resolution = radians([settings.encoder_resolution_deg])[0]
    return RealisticServo(settings.servo_omega, settings.servo_zeta, resolution)


def make_forward_kinematics(robot: RobotModel) -> ForwardKinematics:
    """Return the function from axis angles [rad] to position [m] and A, B, C [rad] of `tip_link` in `base_link`."""
    from construction_twin.frames import rotation_to_abc
    from construction_twin.kinematics.chain import Chain  # needs PyKDL, which the pure core and its users do not

    chain = Chain(robot)

    def forward(angles: tuple[float, ...]):
        pose = chain.forward(joint_angles(robot, angles))
        return pose.position, rotation_to_abc(pose.rotation)

    return forward


def joint_angles(robot: RobotModel, angles: tuple[float, ...]) -> tuple[float, ...]:
    """Convert axis angles of the controller to joint angles of the robot [rad]."""
    return tuple(axis.sign * (value - axis.offset) for axis, value in zip(robot.axes, angles))


def _to_axes(robot: RobotModel, q: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(axis.sign * value + axis.offset for axis, value in zip(robot.axes, q))


class MockRsi:
    """Runs a mock controller against a gateway.

    Parameters
    ----------
    controller : MockController
    gateway : tuple of (str, int)
        Host and UDP port of the gateway.
    restart_after : float, optional
        A stopped controller starts a new RSI session after this time [s]; 0 (default): it stays stopped.
    observe : callable, optional
        Called with this object in every cycle, right after sending; must be quick.
    report : callable, optional
        Called with one sentence when a session starts or stops.

    Attributes
    ----------
    overruns : int
        Packets that left more than half a cycle late, because this process was not run in time.
    skipped : int
        Grid points given up because it was not run for longer than `CATCH_UP`.
    foreign : int
        Datagrams that did not come from the gateway.
    send_errors : int
        Packets the system refused to send.

    Raises
    ------
    TransportError
        If the gateway's host is unknown.
    """

    def __init__(
        self,
        controller: MockController,
        gateway: tuple[str, int],
        restart_after: float = 0.0,
        observe: Callable[[MockRsi], None] = lambda mock: None,
        report: Callable[[str], None] = log.info,
    ):
        self.controller = controller
        self.overruns = self.skipped = self.foreign = self.send_errors = 0
        self._gateway = _resolve(*gateway)
        self._restart_after = round(restart_after * NANOSECONDS)
        self._observe = observe
        self._report = report
        self._requests: SimpleQueue[tuple[Callable[[], object], Future]] = SimpleQueue()
        self._socket: socket.socket | None = None
        self._session = 0
        self._stopped_at: int | None = None

    @property
    def counters(self) -> dict[str, int]:
        """The controller's counters and those of the transport."""
        names = ("overruns", "skipped", "foreign", "send_errors")
        return self.controller.counters | {name: getattr(self, name) for name in names}

    def request(self, action: Callable[[], Result], timeout: float = 1.0) -> Result:
        """Run `action` between two cycles of the loop and return its result; for other threads.

        Raises
        ------
        TimeoutError
            If the loop does not get to it within `timeout` [s].
        """
        future: Future = Future()
        self._requests.put((action, future))
        return future.result(timeout)

    def run(self, stop: threading.Event) -> None:
        """Run until `stop` is set; at most one cycle longer."""
        try:
            due = time.monotonic_ns()
            while not stop.is_set():
                self._serve_requests()
                self._follow_session(due)
                packet = self.controller.begin_cycle()
                if packet is not None:
                    self._send(packet)
                sent = time.monotonic_ns()
                due = self._next_due(due, sent)
                self._observe(self)
                self._receive_until(max(due, sent + _CLOSEST))
        finally:
            if self._socket is not None:
                self._socket.close()

    def _serve_requests(self) -> None:
        while True:
            try:
                action, future = self._requests.get_nowait()
            except Empty:
                return
            try:
                future.set_result(action())
            except ConstructionTwinError as error:
                future.set_exception(error)

    def _follow_session(self, now: int) -> None:
        """Restart when due; every session gets a port of its own."""
        controller = self.controller
        if not controller.running:
            if self._stopped_at is None:
                self._stopped_at = now
                self._report(f"RSI session {controller.session} stopped: {controller.reason}")
            if self._restart_after and now - self._stopped_at >= self._restart_after:
                controller.restart()
        if controller.running:
            self._stopped_at = None
        if controller.session != self._session:
            self._session = controller.session
            self._open_socket()
            self._report(f"RSI session {controller.session} started, IPOC {controller.ipoc}, gateway {self._gateway}")

    def _open_socket(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        # an unused port of the system's choice on all addresses, as the controller does it
        self._socket.bind(("", 0))

    def _send(self, packet: bytes) -> None:
        try:
            self._socket.sendto(packet, self._gateway)
        except OSError:
            # e.g. no route: a controller does not notice, its replies just stay away
            self.send_errors += 1

    def _next_due(self, due: int, sent: int) -> int:
        late = sent - due
        self.overruns += late > _CLOSEST
        skipped = late // CYCLE_NS if late > CATCH_UP else 0
        self.skipped += skipped
        return due + (1 + skipped) * CYCLE_NS

    def _receive_until(self, deadline: int) -> None:
        remaining = deadline - time.monotonic_ns()
        while True:
            # select: poll and epoll count in whole milliseconds
            select.select([self._socket], [], [], max(0, remaining) / NANOSECONDS)
            self._drain()
            remaining = deadline - time.monotonic_ns()
            if remaining <= 0:
                return

    def _drain(self) -> None:
        for _ in range(_DRAIN_LIMIT):
            try:
                data, source = self._socket.recvfrom(MAX_TELEGRAM)
            except BlockingIOError:
                return
            if source == self._gateway:
                self.controller.receive(data)
            else:
                self.foreign += 1


def _resolve(host: str, port: int) -> tuple[str, int]:
    try:
        return socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_DGRAM)[0][4]
    except OSError as error:
        raise TransportError(
            f"gateway host {host!r} port {port}: {error}; give an IPv4 address or a known name"
        ) from error


def _arguments(argv: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="mock_rsi",
        description="Mock KUKA KR C4 with RSI: a UDP client with its own 4 ms clock. Needs no ROS.",
        argument_default=argparse.SUPPRESS,
    )
    option = parser.add_argument
    option("--robot-xacro", type=Path, default=_ROOT / "urdf/kr120r2500.urdf.xacro", help="URDF or xacro [%(default)s]")
    option("--robot-config", type=Path, default=_ROOT / "config/kr120.yaml", help="robot YAML [%(default)s]")
    option("--ethernet-xml", type=Path, default=_ROOT / "krl/ethernet/ctwin_ethernet.xml", metavar="FILE",
           help="the controller's RSI Ethernet XML [%(default)s]")  # fmt: skip
    option(
        "--gateway",
        default="127.0.0.1:0",
        metavar="HOST:PORT",
        help="where packets go; port 0: the Ethernet XML's [%(default)s]",
    )
    option("--start", dest="start_pose_deg", type=_pose, metavar="DEG,...", help="start pose of the axes [deg] [home]")
    option("--precision", type=int, help="decimals of sent values, 1 to 32 [6]")
    option("--timeout", type=int, help="cycles without a valid reply until RSI stops [100]")
    option("--servo", choices=("ideal", "realistic"), help="servo model [ideal]")
    option("--restart-after", type=float, metavar="S", help="new RSI session this long after a stop [s]; 0: never [0]")
    option(
        "--realtime", dest="realtime_priority", type=int, metavar="PRIORITY", help="SCHED_FIFO priority; 0: none [0]"
    )
    return parser.parse_args(argv)


def _pose(text: str) -> list[float]:
    return [float(value) for value in text.split(",")]


def _settings(options: dict) -> MockSettings:
    host, _, port = options.pop("gateway").rpartition(":")
    if "ethernet_xml" in options:
        options["ethernet_xml"] = load_ethernet_xml(options["ethernet_xml"]).text
    try:
        return MockSettings(gateway_host=host, gateway_port=port, **options)
    except pydantic.ValidationError as error:
        first = error.errors()[0]
        raise ConfigurationError("/".join(map(str, first["loc"])), first["input"], first["msg"]) from error


def main(argv: list[str] | None = None) -> int:
    """Run the mock until SIGINT or SIGTERM, then say what was counted; return the exit code."""
    options = vars(_arguments(sys.argv[1:] if argv is None else argv))
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(name)s %(levelname)s %(message)s")
    try:
        robot = read_robot_files(options.pop("robot_xacro"), options.pop("robot_config"))
        settings = _settings(options)
        controller = build_controller(settings, robot)
        mock = MockRsi(controller, gateway_address(settings), settings.restart_after)
    except ConstructionTwinError as error:
        log.error("%s", error)
        return 2
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    log.info(request_realtime(settings.realtime_priority))
    gc.freeze()  # a full collection over every imported module takes longer than a cycle
    mock.run(stop)
    where = ", ".join(f"{value:.4f}" for value in degrees(controller.measured))
    log.info("axes [deg] %s; %s", where, mock.counters)
    return 0


if __name__ == "__main__":
    sys.exit(main())
