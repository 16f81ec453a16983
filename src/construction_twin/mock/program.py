"""The mock controller as a program, without ROS: settings, and what is built from them."""

from __future__ import annotations

import argparse
import gc
import logging
import math
import signal
import sys
import threading
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal
from xml.etree import ElementTree

import pydantic

from construction_twin.controller.port import DEFAULT_MAKE, MODULES, Layout, make_of
from construction_twin.controller.telegram import AxisUnit
from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.core.extensions import check_extras, import_extension
from construction_twin.core.realtime import request_realtime
from construction_twin.core.share import share_file
from construction_twin.core.units import from_wire, to_wire
from construction_twin.mock.config import MockConfig
from construction_twin.mock.controller import ForwardKinematics, MockController
from construction_twin.mock.gripper import Gripper
from construction_twin.mock.network import MockRsi
from construction_twin.mock.servo import IdealServo, RealisticServo, Servo
from construction_twin.robot.description import RobotModel, read_robot_files
from construction_twin.robot.tool import read_tool, tool_of
from construction_twin.validation import StrictModel

log = logging.getLogger(__name__)

#: The file of the default make.
_SHIPPED = share_file("krl/ethernet/ctwin_ethernet.xml")
_Number = Annotated[float, pydantic.Field(allow_inf_nan=False)]
_Numbers = list[_Number]
_Frame = Annotated[_Numbers, pydantic.Field(min_length=6, max_length=6)]

#: servo ideal: cycles from the packet whose reply carries a setpoint to the packet that reports it as reached.
SERVO_DELAY_CYCLES = 3
#: servo realistic, physics: natural frequency [rad/s], damping ratio [1], encoder step [rad].
SERVO_OMEGA, SERVO_ZETA, RESOLUTION = 60.0, 0.8, math.radians(3e-5)
#: The simulated gripper: from its outputs to the inputs that confirm them [s].
TOOL_TIME = 0.2


class AnotherArm(StrictModel):
    """How the mock's arm differs from the model: what an operator may get wrong; it moves `RIst` alone."""

    tool: _Frame = [0.0] * 6
    base: _Frame = [0.0] * 6
    reversed: str = ""
    longer: dict[str, _Number] = {}


class MockSettings(StrictModel):
    """What can be set on the mock from outside; config/mock_rsi.yaml explains every key."""

    gateway_host: str
    gateway_port: Annotated[int, pydantic.Field(ge=0, le=65535)] = 0
    make: str = DEFAULT_MAKE
    ethernet_xml: str = ""
    cycle: int = 4
    precision: Annotated[int, pydantic.Field(ge=1, le=32)] = 6
    timeout: Annotated[int, pydantic.Field(ge=1)] = 100
    start_pose_deg: _Numbers = []
    e1_sign: Literal[1, -1] = 1
    e1_offset: Annotated[float, pydantic.Field(allow_inf_nan=False)] = 0.0
    e1_feedback_scale: Annotated[float, pydantic.Field(gt=0, allow_inf_nan=False)] = 1.0
    e1_correction_scale: Annotated[float, pydantic.Field(gt=0, allow_inf_nan=False)] = 1.0
    servo: Literal["ideal", "realistic", "physics"] = "ideal"
    drives: str = ""
    payload: _Numbers = []
    another_arm: AnotherArm = AnotherArm()
    fault_seed: Annotated[int, pydantic.Field(ge=0)] = 0
    restart_after: Annotated[float, pydantic.Field(ge=0)] = 0.0
    tool: dict = {}
    realtime_priority: Annotated[int, pydantic.Field(ge=0, le=99)] = 0


def build_controller(settings: MockSettings, robot: RobotModel) -> MockController:
    """Build the controller of `robot` as `settings` say."""
    axes = tuple(axis.name for axis in robot.axes)
    lower, upper = zip(*robot.axis_ranges)
    e1 = settings.e1_sign, settings.e1_offset, settings.e1_feedback_scale, settings.e1_correction_scale

    def listed(name: str) -> tuple[float, ...] | None:
        values = getattr(settings, name)
        if values and len(values) != len(robot.axes):
            raise ConfigurationError(name, values, f"{len(robot.axes)} numbers, one per joint, or none")
        return from_wire(values, robot.linear) if values else None

    config = MockConfig(
        axes=axes,
        start_pose=listed("start_pose_deg") or robot.to_axes(robot.home),
        lower=lower,
        upper=upper,
        velocity=robot.velocity,
        acceleration=robot.acceleration,
        layout=_layout(settings, axes),
        units=tuple(AxisUnit(linear, *(e1 if axis == "E1" else ())) for axis, linear in zip(axes, robot.linear)),
        cycle=settings.cycle,
        precision=settings.precision,
        timeout=settings.timeout,
        gripper=_gripper(settings),
    )
    return MockController(config, build_servo(settings, robot), build_forward_kinematics(robot, settings.another_arm))


def _gripper(settings: MockSettings) -> Gripper:
    """Return the gripper of a tool file; ConfigurationError for an invalid one."""
    if not settings.tool:
        return Gripper(time=TOOL_TIME)
    tool = tool_of(settings.tool, "tool")
    grip, release = tool.grip, tool.release
    return Gripper(grip.set, grip.confirm, release.set, release.confirm, TOOL_TIME)


def gateway_address(settings: MockSettings) -> tuple[str, int]:
    """Return where packets go: the port is that of the controller's file, unless another one is given."""
    make, layout = make_of(settings.make), _layout(settings, ())
    if settings.gateway_port:
        return settings.gateway_host, settings.gateway_port
    if make.file is not None and not settings.ethernet_xml:
        raise ConfigurationError("gateway_port", 0, f"a port, or {make.terms.description} that names it")
    return settings.gateway_host, layout.port


def _layout(settings: MockSettings, axes: tuple[str, ...]) -> Layout:
    return make_of(settings.make).layout_of(settings.ethernet_xml, axes)


def build_servo(settings: MockSettings, robot: RobotModel) -> Servo:
    """Build the servo model that `settings.servo` names."""
    period = settings.cycle / 1000
    if settings.servo == "physics":
        check_extras("physics")
        return import_extension("physics.mock_servo").physics_servo(settings, robot, period)
    if settings.servo == "ideal":
        return IdealServo(SERVO_DELAY_CYCLES, period)
    return RealisticServo(SERVO_OMEGA, SERVO_ZETA, RESOLUTION, period)


def build_forward_kinematics(robot: RobotModel, another: AnotherArm = AnotherArm()) -> ForwardKinematics:
    """Return the function from axis values [rad], [m] to position [m] and A, B, C [rad] of the tool in the base.

    `another`: how the mock's arm differs from the model.
    """
    # needs PyKDL, which the pure core and its users do not
    from construction_twin.kinematics.chain import Chain, pendant_frame
    from construction_twin.robot.frames import rotation_to_abc

    if another.longer or another.reversed:
        robot = _another_robot(robot, another)
    chain = Chain(robot)
    tool, base = pendant_frame(another.tool), pendant_frame(another.base).Inverse()

    def forward(angles: tuple[float, ...]):
        frame = base * chain.frame(robot.from_axes(angles)) * tool
        return (frame[0, 3], frame[1, 3], frame[2, 3]), rotation_to_abc(frame)

    return forward


def _another_robot(robot: RobotModel, another: AnotherArm) -> RobotModel:
    """Return the robot with an axis reversed, and joints' origins further from the joints before [mm]."""
    names = ["", *(axis.name for axis in robot.axes)]
    if another.reversed not in names:
        raise ConfigurationError("another_arm/reversed", another.reversed, f"one of {', '.join(names[1:])}")
    axes = tuple(replace(axis, sign=-axis.sign) if axis.name == another.reversed else axis for axis in robot.axes)
    urdf = ElementTree.fromstring(robot.urdf)
    for name, longer in another.longer.items():
        origin = urdf.find(f"joint[@name='{name}']/origin")
        if origin is None:
            raise ConfigurationError("another_arm/longer", name, "a joint of the URDF with an origin")
        xyz = [float(value) for value in origin.get("xyz", "0 0 0").split()]
        largest = max(range(3), key=lambda index: abs(xyz[index]))
        xyz[largest] += math.copysign(longer / 1e3, xyz[largest])
        origin.set("xyz", " ".join(map(str, xyz)))
    return replace(robot, axes=axes, urdf=ElementTree.tostring(urdf, "unicode"))


def parse_arguments(argv: list[str]) -> argparse.Namespace:
    """Return the options of the command line; only those that were given, or have a default."""
    parser = argparse.ArgumentParser(
        prog="mock_rsi",
        description="Mock robot controller, a KUKA KR C4 with RSI by default: a UDP client with its own clock. Needs no ROS.",
        argument_default=argparse.SUPPRESS,
    )
    option = parser.add_argument
    option(
        "--robot-xacro", type=Path, default=share_file("urdf/kr120r2500.urdf.xacro"), help="URDF or xacro [%(default)s]"
    )
    option("--robot-xacro-args", metavar="'NAME=VALUE ...'", help="arguments of the xacro [its defaults]")
    option("--robot-config", type=Path, default=share_file("config/kr120.yaml"), help="robot YAML [%(default)s]")
    option("--make", choices=tuple(MODULES), default=DEFAULT_MAKE, help="make of the controller [%(default)s]")
    option("--ethernet-xml", type=Path, metavar="FILE",
           help=f"file that describes its telegrams; of {DEFAULT_MAKE} the Ethernet XML [{_SHIPPED}]")  # fmt: skip
    option("--tool", type=Path, metavar="FILE", help="tool file of the gripper that is simulated [none]")
    option(
        "--gateway",
        default="127.0.0.1:0",
        metavar="HOST:PORT",
        help="where packets go; port 0: that of the controller's file [%(default)s]",
    )
    option(
        "--start",
        dest="start_pose_deg",
        type=_pose,
        metavar="DEG,...",
        help="start pose of the axes [deg], prismatic ones [mm], as the robot's joints are ordered [home]",
    )
    option("--cycle", type=int, help="length of a cycle [ms], one that the make has [4]")
    option("--precision", type=int, help="decimals of sent values, 1 to 32 [6]")
    option("--timeout", type=int, help="cycles without a valid reply until the session stops [100]")
    option("--servo", choices=("ideal", "realistic", "physics"), help="servo model; physics: an arm with mass [ideal]")
    option("--drives", metavar="FILE", help="with --servo physics: YAML of the arm's drives [what the URDF says]")
    option(
        "--payload",
        type=_pose,
        metavar="KG[,X,Y,Z]",
        help="with --servo physics: mass at the flange, and its centre [m] [none]",
    )
    option("--restart-after", type=float, metavar="S", help="new session this long after a stop [s]; 0: never [0]")
    option(
        "--realtime", dest="realtime_priority", type=int, metavar="PRIORITY", help="SCHED_FIFO priority; 0: none [0]"
    )
    return parser.parse_args(argv)


def _pose(text: str) -> list[float]:
    return [float(value) for value in text.split(",")]


def checked_settings(options: dict) -> MockSettings:
    """Return the settings that `parse_arguments` gave; ConfigurationError when one makes no sense."""
    host, _, port = options.pop("gateway").rpartition(":")
    make = make_of(options.get("make", DEFAULT_MAKE))
    path = options.pop("ethernet_xml", _SHIPPED if make.name == DEFAULT_MAKE else None)
    if path is not None:
        options["ethernet_xml"] = str(path)
    if "tool" in options:
        options["tool"] = read_tool(options["tool"]).tool.model_dump()
    return MockSettings.read({"gateway_host": host, "gateway_port": port, **options})


def main(argv: list[str] | None = None) -> int:
    """Run the mock until SIGINT or SIGTERM, then say what was counted; return the exit code."""
    options = vars(parse_arguments(sys.argv[1:] if argv is None else argv))
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(name)s %(levelname)s %(message)s")
    try:
        robot = read_robot_files(
            options.pop("robot_xacro"), options.pop("robot_config"), options.pop("robot_xacro_args", "")
        )
        settings = checked_settings(options)
        controller = build_controller(settings, robot)
        mock = MockRsi(controller, gateway_address(settings), settings.restart_after, fault_seed=settings.fault_seed)
    except ConstructionTwinError as error:
        log.error("%s", error)
        return 2
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    log.info(request_realtime(settings.realtime_priority))
    gc.freeze()  # a full collection over every imported module takes longer than a cycle
    mock.run(stop)
    where = ", ".join(f"{value:.4f}" for value in to_wire(controller.measured, robot.linear))
    log.info("axes [deg, mm] %s; %s", where, mock.counters)
    return 0
