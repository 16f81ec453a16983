"""The obstacles to a start, in the order in which things come up, and their remedies. Pure; times in s."""

from __future__ import annotations

from dataclasses import dataclass

from construction_twin.core.sentences import Sentence, join_sentences
from construction_twin.link.gateway_status import without_counts

#: Something is reported as waited for when it has been missing this long [s]: a part that starts within it is not reported.
PATIENCE = 1.0


#: Who is waited for. `system` goes on by itself; the others are people: at the cell, with the right to approve, for the machines.
SYSTEM, OPERATOR, REVIEWER, TECHNICIAN = "system", "operator", "reviewer", "technician"
WHO = ("", SYSTEM, OPERATOR, REVIEWER, TECHNICIAN)


@dataclass(frozen=True)
class Deployment:
    """What was started, and where the rest should be; `broker`, `rsi`: HOST:PORT, port 0 is the Ethernet XML's.

    `gateway`: started on this machine. `gateway_kind`: ``rsi``, or ``plc`` for a bare PLC.
    """

    namespace: str
    arm: str
    broker: str
    rsi: str
    gateway: bool
    gateway_kind: str = "rsi"

    @property
    def rsi_address(self) -> str:
        """Where the gateway listens, in words."""
        if not self.gateway:
            return Sentence("the address given to rsi_gateway --listen")
        host, _, port = self.rsi.rpartition(":")
        return Sentence("{host}, PORT of the Ethernet XML", host=host) if port == "0" else self.rsi


@dataclass(frozen=True)
class ReportedState:
    """State word and reason of a report; in the bridge's also the gateway's state."""

    state: str
    reason: str
    gateway: str = ""


@dataclass(frozen=True)
class StartupInputs:
    """The inputs received so far."""

    link: ReportedState | None = None
    sync: ReportedState | None = None
    execution: ReportedState | None = None
    feedback: bool = False
    twin: bool = False
    scene: bool = False


@dataclass(frozen=True)
class WaitReason:
    """What a start waits for: who can do something about it, of `WHO`, what it is, and what to do."""

    who: str
    what: str
    todo: str


def _wait_reason(kind: str, at: Deployment) -> WaitReason:
    broker, rsi, robot = at.broker, at.rsi_address, at.namespace.strip("/")
    return {
        "nodes": WaitReason(SYSTEM, Sentence("the nodes"), Sentence("nothing to do yet")),
        "bridge": WaitReason(
            TECHNICIAN, Sentence("the bridge"),
            Sentence("mqtt_bridge does not run; its reason stands in its log"),
        ),
        "broker": WaitReason(
            TECHNICIAN, Sentence("the MQTT broker {broker}", broker=broker),
            Sentence("start it, or give broker_host and broker_port"),
        ),
        "gateway_here": WaitReason(
            TECHNICIAN, Sentence("the gateway"),
            Sentence("read its lines here; is UDP {rsi} taken?", rsi=rsi),
        ),
        "gateway_there": WaitReason(
            TECHNICIAN, Sentence("the gateway"),
            Sentence("start rsi_gateway on the cell PC with --broker {broker}", broker=broker),
        ),
        "configuration": WaitReason(
            TECHNICIAN, Sentence("the gateway's configuration"),
            Sentence("export it again, copy it, restart the gateway"),
        ),
        "other_arm": WaitReason(
            TECHNICIAN, Sentence("an arm that is the model's"),
            Sentence("compare $TOOL, $BASE and the axes with the pendant (docs/troubleshooting.md)"),
        ),
        "plc": WaitReason(
            OPERATOR, Sentence("the PLC"),
            Sentence("start it; it says `ready` on its `status` topic, retained"),
        ),
        "plc_other": WaitReason(
            OPERATOR, Sentence("the PLC"),
            Sentence("stop what answers there, or start with the other gateway_kind"),
        ),
        "plc_pose": WaitReason(
            OPERATOR, Sentence("the PLC's pose"),
            Sentence("let it send joint strings on its `state` topic, without user properties"),
        ),
        "measuring": WaitReason(
            SYSTEM, Sentence("the controller (RSI)"),
            Sentence("nothing to do, it goes on by itself within seconds"),
        ),
        "cycle": WaitReason(
            OPERATOR, Sentence("the controller (RSI)"),
            Sentence("correct RSI_ON in the program, and start it again"),
        ),
        "no_clock": WaitReason(
            OPERATOR, Sentence("the controller (RSI)"),
            Sentence("see what sends to {rsi}: a controller's IPOC counts milliseconds of real time", rsi=rsi),
        ),
        "cycle_mock": WaitReason(
            OPERATOR, Sentence("the controller (RSI)"),
            Sentence("give gateway and mock_rsi one rsi_cycle"),
        ),
        "running": WaitReason(
            OPERATOR, Sentence("the controller (RSI)"),
            Sentence("start the RSI program again once RSI has timed out"),
        ),
        "running_mock": WaitReason(SYSTEM, Sentence("the controller (RSI)"), Sentence("it starts again by itself")),
        "controller": WaitReason(
            OPERATOR, Sentence("the controller (RSI)"),
            Sentence("start the RSI program, or cure what is refused; the controller sends to {rsi}", rsi=rsi),
        ),
        "controller_mock": WaitReason(
            OPERATOR, Sentence("the controller (RSI)"),
            Sentence("look why mock_rsi does not send, or what it sends"),
        ),
        "pose": WaitReason(
            TECHNICIAN, Sentence("the first pose of the arm"),
            Sentence("look at `/diagnostics` of mqtt_bridge: what does it refuse?"),
        ),
        "twin": WaitReason(
            TECHNICIAN, Sentence("the twin"),
            Sentence("look why /{robot}/virtual_robot publishes nothing", robot=robot),
        ),
        "scene": WaitReason(
            TECHNICIAN, Sentence("the scene"),
            Sentence("look why /{robot}/scene publishes nothing; is its file right?", robot=robot),
        ),
        "responsible": WaitReason(
            OPERATOR, Sentence("a person who arms the bare PLC by name"),
            Sentence("arm it by name: on the console, or `twin --robot {robot} arm --responsible NAME`", robot=robot),
        ),
        "reset": WaitReason(
            OPERATOR, Sentence("a reset"),
            Sentence("remove the cause, then reset: on the console, or `twin --robot {robot} reset`", robot=robot),
        ),
        "same_pose": WaitReason(
            SYSTEM, Sentence("twin and arm to take the same pose"),
            Sentence("nothing to do, it goes on by itself once the arm rests"),
        ),
        "gate": WaitReason(SYSTEM, Sentence("the gate to open"), Sentence("it opens when twin and arm agree")),
        "gate_reset": WaitReason(
            OPERATOR, Sentence("the gate to open"),
            Sentence("reset: on the console with the right to, or call reset on the robot's PC"),
        ),
        "executor": WaitReason(SYSTEM, Sentence("the executor"), Sentence("it follows the gate")),
    }[kind]  # fmt: skip


@dataclass(frozen=True)
class Missing:
    """What is waited for."""

    kind: str
    reason: str
    deployment: Deployment

    @property
    def wait_reason(self) -> WaitReason:
        """The wait reason shown to people."""
        return _wait_reason(self.kind, self.deployment)

    @property
    def log_key(self) -> tuple[str, str]:
        """The key whose change is worth another line."""
        return self.kind, without_counts(self.reason)

    def __str__(self) -> str:
        # a reason that comes with what to do about it needs no more
        wait = self.wait_reason
        return (
            f"waiting for {wait.what}: {self.reason if '; ' in self.reason else join_sentences(self.reason, wait.todo)}"
        )


class StartUp:
    """Turns inputs into lines for the operator, each once."""

    def __init__(self, deployment: Deployment):
        self._deployment = deployment
        self.missing: Missing | None = Missing("nodes", "", deployment)
        # since when this is missing, and since when for this reason
        self._since = self._reason_since = 0.0
        self._logged: Missing | None = None
        self._ready = False

    def update(self, inputs: StartupInputs, now: float) -> list[str]:
        """Store the inputs at a monotonic time [s]; return new lines."""
        missing, before = first_missing(inputs, self._deployment), self.missing
        if missing is None or before is None or missing.kind != before.kind or not self._since:
            self._since = self._reason_since = now
        elif missing.log_key != before.log_key:
            self._reason_since = now
        self.missing = missing
        if missing is None:
            return self._become_ready()
        logged = self._logged
        if logged is not None and missing.log_key == logged.log_key:
            return []
        # reasons that alternate must not keep back that something is missing, nor make a line each
        was_logged = logged is not None and missing.kind == logged.kind
        if now - (self._reason_since if was_logged else self._since) < PATIENCE:
            return []
        text = f"not ready any more, {missing}" if self._ready else str(missing)
        self._logged, self._ready = missing, False
        return [text]

    def _become_ready(self) -> list[str]:
        if self._ready and self._logged is None:
            return []
        self._ready, self._logged = True, None
        robot = self._deployment.namespace.strip("/")
        return [f"ready; plan with `rosrun construction_twin twin --robot {robot} plan ...`, look with `... watch`"]


def first_missing(inputs: StartupInputs, deployment: Deployment) -> Missing | None:
    """Return the first thing that is not there yet, None when everything is."""
    steps = (_twin_or_scene, _gate) if deployment.arm == "none" else (_link, _twin_or_scene, _armed, _gate)
    for step in steps:
        found = step(inputs, deployment)
        if found is not None:
            return Missing(*found, deployment)
    return None


#: What is missing at a bare PLC, by the link's state.
_PLC = {"GATEWAY_OFFLINE": "plc", "MISMATCH": "plc_other", "NO_CONTROLLER": "plc_pose"}
#: What is missing at the controller, by the gateway's state, with a real arm and with the mock.
_CONTROLLER = {
    "measuring": ("measuring", "measuring"),
    "other_cycle": ("cycle", "cycle_mock"),
    "joined_running": ("running", "running_mock"),
}

#: What the gateway says of a clock that no setting of the program can mend.
_NOT_IN_REAL_TIME = "what sends is no controller in real time"

#: Kind of what is missing, and the system's own reason.
_Found = tuple[str, str] | None


def _link(inputs: StartupInputs, deployment: Deployment) -> _Found:
    report = inputs.link or ReportedState("", "")
    state, reason = report.state, report.reason
    if not state:
        return "bridge", Sentence("no report")
    if state == "DISCONNECTED":
        return "broker", reason
    if deployment.gateway_kind == "plc" and state in _PLC:
        return _PLC[state], reason
    if state == "GATEWAY_OFFLINE":
        return "gateway_here" if deployment.gateway else "gateway_there", reason
    if state == "MISMATCH":
        return "configuration", reason
    if state == "OTHER_ARM":
        return "other_arm", reason
    if state == "NO_CONTROLLER":
        if report.gateway == "other_cycle" and _NOT_IN_REAL_TIME in reason:
            return "no_clock", reason
        real, mock = _CONTROLLER.get(report.gateway, ("controller", "controller_mock"))
        return real if deployment.arm == "real" else mock, reason
    return None if inputs.feedback else ("pose", reason)


def _twin_or_scene(inputs: StartupInputs, deployment: Deployment) -> _Found:
    if not inputs.twin:
        return "twin", ""
    return None if inputs.scene else ("scene", "")


def _armed(inputs: StartupInputs, deployment: Deployment) -> _Found:
    report = inputs.link or ReportedState("", "")
    if report.state == "NEEDS_RESET":
        return ("responsible", "") if deployment.gateway_kind == "plc" else ("reset", report.reason)
    return ("same_pose", report.reason) if report.state == "RESYNC" else None


def _gate(inputs: StartupInputs, deployment: Deployment) -> _Found:
    if inputs.link is not None and inputs.link.state == "MIRROR":
        return None  # the arm leads; the gate is closed on purpose
    report = inputs.sync or ReportedState("", Sentence("no report of {node}", node="pca_monitor"))
    if report.state != "IN_SYNC":
        kind = "gate_reset" if report.state in ("STOPPED", "FAULT") else "gate"
        return kind, Sentence("{state}: {reason}", state=report.state or "silent", reason=report.reason)
    if inputs.execution is None or inputs.execution.state == "WAITING":
        return "executor", inputs.execution.reason if inputs.execution else Sentence("no report")
    return None
