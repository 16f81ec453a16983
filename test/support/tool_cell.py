"""A gateway and a mock controller with a gripper, joined by real telegrams on one simulated clock, and a sender."""

from __future__ import annotations

import dataclasses

from mock_cell import AXES, CONFIG, HOME, forward_kinematics
from processes import ROOT

from construction_twin.controller.port import GatewayTool, ToolOutput
from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.gateway.config import GatewayConfig
from construction_twin.gateway.controller_socket import TelegramInbox
from construction_twin.gateway.gateway import Gateway, State
from construction_twin.mock.controller import MockController
from construction_twin.mock.gripper import Gripper
from construction_twin.mock.servo import IdealServo
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import CommandProperties, Control, arm_value, reset_value
from construction_twin.rsi.ethernet_xml import load_ethernet_xml
from construction_twin.rsi.gateway_codec import SensorEncoder

#: The Ethernet XML that is shipped for config/tools/vacuum_frame.yaml, and that tool.
LAYOUT = load_ethernet_xml(ROOT / "krl/ethernet/ctwin_tool_ethernet.xml").layout
TOOL = GatewayTool("vacuum_frame", (ToolOutput("vacuum", "keep", False),), ("vacuum_reached",))
GRIPPER = Gripper({"vacuum": True}, {"vacuum_reached": True}, {"vacuum": False}, {"vacuum_reached": False}, 0.2)
RUN = "run1"
#: The sender's clock when the cell's reads 0.
EPOCH = 1_764_000_000_000_000_000


def switched_off_on_stop(layout=LAYOUT):
    """Return the shipped layout with a HOLDON that switches the vacuum off, and the tool file that says so."""
    layout = dataclasses.replace(layout, switched_holdon=(True, False))
    return layout, dataclasses.replace(TOOL, outputs=(ToolOutput("vacuum", "off"),))


class ToolCell:
    """Everything between a command and `$OUT`, without sockets.

    Args:
        layout, tool: Default: the shipped ones.
        commissioning: Bool
        changes: Of the gateway's configuration.
    """

    def __init__(self, layout=LAYOUT, tool=TOOL, commissioning=False, **changes):
        mock = dataclasses.replace(CONFIG, layout=layout, gripper=GRIPPER)
        self.config = GatewayConfig(
            "arm", AXES, mock.lower, mock.upper, mock.velocity, mock.acceleration, layout=layout, tool=tool, **changes
        )
        self.controller = MockController(mock, IdealServo(3), forward_kinematics)
        self.codec = JointStringCodec(6, self.config.decimals)
        self.encoder = SensorEncoder.of(layout, AXES)
        self.now = 50 * NANOSECONDS
        self.stamp, self.seq, self.controls = EPOCH, 0, 0
        #: Whether telegrams reach the gateway, and whether replies reach the controller.
        self.answering = self.delivering = True
        #: Per answered telegram, the values that the reply carried.
        self.sent = []
        self.source = ("192.168.1.20", 49152)
        self.start_gateway(commissioning=commissioning)

    def start_gateway(self, run=RUN, commissioning=False):
        """Start the gateway, anew."""
        self.gateway = Gateway(self.config, run, commissioning)
        self._waiting = []
        self._inbox = TelegramInbox(self.gateway, self._receive)

    def _receive(self):
        if not self._waiting:
            raise BlockingIOError
        return self._waiting.pop(0), self.now, self.source

    @property
    def tool(self):
        """The mock's."""
        return self.controller.tool

    @property
    def out(self):
        """Whether the vacuum is on, as `$OUT` says."""
        return self.tool.outputs["vacuum"]

    @property
    def state(self):
        return self.gateway.state

    def status(self):
        return self.gateway.status()["tool"]

    def switches(self):
        """Return the told switches' states by id."""
        return {switch["id"]: switch["state"] for switch in self.status()["switches"]}

    def cycle(self, count=1):
        """Let cycles of the controller pass, each answered by the gateway."""
        for _ in range(count):
            self.now += CYCLE_NS
            packet = self.controller.begin_cycle()
            self.gateway.poll(self.now)
            if packet is None or not self.answering:
                continue
            self._waiting.append(packet)
            telegram = self._inbox.newest(self.now).telegram
            correction = self.gateway.on_telegram(telegram, self.source, self.now)
            if correction is None:
                continue
            values = self.gateway.tool.channels(self.gateway.ends_program) if self.gateway.tool else ()
            self.sent.append(dict(zip(self.config.layout.switched, values)))
            stop = True if self.gateway.ends_program else None
            if not self.delivering:
                continue
            self.controller.receive(self.encoder.encode(correction, telegram.controller_ms, stop, values))

    def restart(self):
        """End RSI and switch it on again, in another session."""
        self.controller.restart()
        self.source = (self.source[0], self.source[1] + 1)
        self.now += NANOSECONDS // 5

    def send(self, q=HOME, session="s1"):
        self.stamp += CYCLE_NS
        self.seq += 1
        beside = CommandProperties(session, self.seq, self.stamp)
        self.gateway.on_command(self.codec.encode(q), beside, self.now)

    def stream(self, count, q=HOME):
        """A command every 4 ms, and a cycle after each."""
        for _ in range(count):
            self.send(q)
            self.cycle()

    def control(self, verb, value=None, session="s1", id=None):
        self.controls += 1
        if verb == "reset" and value is None:
            value = reset_value(self.gateway.run, self.gateway.fault_number)
        answer = self.gateway.on_control(Control(id or str(self.controls), session, verb, value), self.now)
        return answer.ok, answer.reason

    def switch(self, value=True, ahead=10, id=None, session="s1", output="vacuum", **changes):
        """Ask for a switch, `ahead` commands behind the newest one."""
        self.controls += 1
        id = id or f"switch{self.controls}"
        content = {"id": id, "output": output, "value": value, "stamp": self.stamp + ahead * CYCLE_NS}
        answer = self.gateway.on_control(Control(id, session, "switch", content | changes), self.now)
        return answer.ok, answer.reason

    def follow(self, count=50):
        """Lead the gateway to a stream that it follows."""
        self.cycle(3)
        if self.gateway.fault or self.state is State.HOLDING:
            assert self.control("reset")[0]
        session = f"s{self.controls}"
        ok, reason = self.control("arm", arm_value(self.config.hash, self.gateway.run), session)
        assert ok, reason
        self.session = session
        for _ in range(count):
            self.send(session=session)
            self.cycle()
        assert self.state is State.FOLLOWING, self.gateway.reason
        return self

    def go_on(self, count):
        """Go on with the stream."""
        for _ in range(count):
            self.send(session=self.session)
            self.cycle()

    def ask(self, value=True, **options):
        """Ask for a switch from the session that commands."""
        return self.switch(value, session=self.session, **options)
