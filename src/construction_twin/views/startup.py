"""What a start waits for, in the order in which things come up, and what a person can do about it. Pure; times in s."""

from __future__ import annotations

from dataclasses import dataclass

from construction_twin.link.status_values import without_counts

#: Something is reported as waited for when it has been missing this long [s]: a part that starts within it is not reported.
PATIENCE = 1.0


@dataclass(frozen=True)
class Deployment:
    """What was started, and where the rest should be.

    Attributes
    ----------
    namespace : str
        Of the robot, absolute.
    arm : str
        ``mock``, ``real`` or ``none``.
    broker : str
        HOST:PORT
    rsi : str
        HOST:PORT on which the gateway should listen; port 0: that of the Ethernet XML.
    gateway : bool
        The gateway is started on this machine.
    gateway_kind : str
        ``rsi``: rsi_gateway takes the commands; ``plc``: a bare PLC.
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
            return "the address given to rsi_gateway --listen"
        host, _, port = self.rsi.rpartition(":")
        return f"{host}, PORT of the Ethernet XML" if port == "0" else f"port {self.rsi}"


@dataclass(frozen=True)
class Word:
    """State word and reason of a report.

    Attributes
    ----------
    state, reason : str
    gateway : str
        State of the gateway, in the bridge's report.
    """

    state: str
    reason: str
    gateway: str = ""


@dataclass(frozen=True)
class Seen:
    """What was heard so far.

    Attributes
    ----------
    link, sync, execution : Word or None
        Of the three reports.
    feedback, twin, scene : bool
        Whether a pose of the arm, a pose of the twin, a scene has come.
    controller : str
        Why the arm may not move, as the controller says itself; "" for no reason.
    clock : str
        By how much the controller's clock is off, as the gateway has measured it; "" when it is not known to be.
    """

    link: Word | None = None
    sync: Word | None = None
    execution: Word | None = None
    feedback: bool = False
    twin: bool = False
    scene: bool = False
    controller: str = ""
    clock: str = ""


@dataclass(frozen=True)
class Missing:
    """What is waited for.

    Attributes
    ----------
    what : str
    reason : str
        What the system says about it; may be empty.
    action : str
        What to do.
    """

    what: str
    reason: str
    action: str

    @property
    def topic(self) -> tuple[str, str]:
        """What is missing, whatever the system says about it meanwhile."""
        return self.what, self.action

    @property
    def news(self) -> tuple[str, str, str]:
        """What would be worth another line when it changes."""
        return self.what, without_counts(self.reason), self.action

    def __str__(self) -> str:
        return f"waiting for {self.what}{f' ({self.reason})' if self.reason else ''}: {self.action}"


class StartUp:
    """Turns what is seen into lines for the operator, each once.

    Parameters
    ----------
    deployment : Deployment

    Attributes
    ----------
    missing : Missing or None
        What is waited for now.
    """

    def __init__(self, deployment: Deployment):
        self._deployment = deployment
        self.missing: Missing | None = Missing("the nodes", "", "nothing to do yet")
        # since when this is missing, and since when for this reason
        self._since = self._reason_since = 0.0
        self._said: Missing | None = None
        self._ready = False
        self._controller = _Beside("the controller reports nothing against a motion any more")
        self._clock = _Beside("the controller's clock is right again")

    def update(self, seen: Seen, now: float) -> list[str]:
        """Take what is seen; return the lines that are news.

        Parameters
        ----------
        seen : Seen
        now : float
            On a clock that never runs back [s].
        """
        beside = self._controller.update(seen.controller, now) + self._clock.update(seen.clock, now)
        return self._progress(seen, now) + beside

    def _progress(self, seen: Seen, now: float) -> list[str]:
        missing, before = first_missing(seen, self._deployment), self.missing
        if missing is None or before is None or missing.topic != before.topic or not self._since:
            self._since = self._reason_since = now
        elif missing.news != before.news:
            self._reason_since = now
        self.missing = missing
        if missing is None:
            return self._become_ready()
        said = self._said
        if said is not None and missing.news == said.news:
            return []
        # reasons that alternate must not keep back that something is missing, nor make a line each
        told = said is not None and missing.topic == said.topic
        if now - (self._reason_since if told else self._since) < PATIENCE:
            return []
        text = f"not ready any more, {missing}" if self._ready else str(missing)
        self._said, self._ready = missing, False
        return [text]

    def _become_ready(self) -> list[str]:
        if self._ready and self._said is None:
            return []
        self._ready, self._said = True, None
        robot = self._deployment.namespace.strip("/")
        return [f"ready; plan with `rosrun construction_twin twin --robot {robot} plan ...`, look with `... watch`"]


class _Beside:
    """Tells what nothing waits for, but a person should know: when it has stood for `PATIENCE`, and that it does no more."""

    def __init__(self, gone: str):
        self._gone = gone
        self._sentence = self._said = ""
        self._since = 0.0

    def update(self, sentence: str, now: float) -> list[str]:
        """Return what is to be told now: the sentence once it has stood long enough, or that it is gone; `now` in s."""
        news = without_counts(sentence)
        if news != self._sentence:
            self._sentence, self._since = news, now
        if news == self._said or now - self._since < PATIENCE:
            return []
        self._said = news
        return [sentence or self._gone]


def first_missing(seen: Seen, deployment: Deployment) -> Missing | None:
    """Return the first thing that is not there yet, None when everything is."""
    if deployment.arm == "none":
        return _twin(seen, deployment) or _gate(seen)
    return _link(seen, deployment) or _twin(seen, deployment) or _armed(seen, deployment) or _gate(seen)


#: What is missing at a bare PLC, by the link's state, and what to do.
_PLC = {
    "GATEWAY_OFFLINE": ("the PLC", "start it; it says `ready` on its `status` topic, retained"),
    "MISMATCH": ("the PLC", "stop what answers there, or start with the other gateway_kind"),
    "NO_CONTROLLER": ("the PLC's pose", "let it send joint strings on its `state` topic, without user properties"),
}


def _link(seen: Seen, deployment: Deployment) -> Missing | None:
    """Broker, gateway, configuration, controller, first feedback."""
    word = seen.link or Word("", "")
    state, reason = word.state, word.reason
    if not state:
        return Missing("the bridge", "no report", "mqtt_bridge does not run; its reason stands in its log")
    if state == "DISCONNECTED":
        return Missing(f"the MQTT broker {deployment.broker}", reason, "start it, or give broker_host and broker_port")
    if deployment.gateway_kind == "plc" and state in _PLC:
        what, action = _PLC[state]
        return Missing(what, reason, action)
    if state == "GATEWAY_OFFLINE":
        here = f"read its lines here; is UDP {deployment.rsi_address} taken?"
        there = f"start rsi_gateway on the cell PC with --broker {deployment.broker}"
        return Missing("the gateway", reason, here if deployment.gateway else there)
    if state == "MISMATCH":
        return Missing("the gateway's configuration", reason, "export it again, copy it, restart the gateway")
    if state == "NO_CONTROLLER":
        return Missing("the controller (RSI)", reason, _action_for_controller(word.gateway, deployment))
    if not seen.feedback:
        return Missing(
            "the first pose of the arm", reason, "look at `/diagnostics` of mqtt_bridge: what does it refuse?"
        )
    return None


def _action_for_controller(gateway: str, deployment: Deployment) -> str:
    real = deployment.arm == "real"
    if gateway == "measuring":
        return "nothing to do, it goes on by itself within seconds"
    if gateway == "other_cycle":
        return (
            "correct RSI_ON in the program, and start it again" if real else "give gateway and mock_rsi one rsi_cycle"
        )
    if gateway == "joined_running":
        return "start the RSI program again once RSI has timed out" if real else "it starts again by itself"
    program = f"start the RSI program, or cure what is refused; the controller sends to {deployment.rsi_address}"
    return program if real else "look why mock_rsi does not send, or what it sends"


def _twin(seen: Seen, deployment: Deployment) -> Missing | None:
    if not seen.twin:
        return Missing("the twin", "", f"look why {deployment.namespace}/virtual_robot publishes nothing")
    if not seen.scene:
        return Missing("the scene", "", f"look why {deployment.namespace}/scene publishes nothing; is its file right?")
    return None


def _armed(seen: Seen, deployment: Deployment) -> Missing | None:
    word = seen.link or Word("", "")
    state, reason = word.state, word.reason
    if state == "NEEDS_RESET" and deployment.gateway_kind == "plc":
        robot = deployment.namespace.strip("/")
        call = f"see to PLC and arm, then rosrun construction_twin twin --robot {robot} arm --responsible NAME"
        return Missing("a person who arms the bare PLC by name", "", call)
    if state == "NEEDS_RESET":
        robot = deployment.namespace.strip("/")
        call = f"remove the cause, then on the robot's PC: rosrun construction_twin twin --robot {robot} reset"
        return Missing("a reset", reason, call)
    if state == "RESYNC":
        return Missing(
            "twin and arm to take the same pose", reason, "nothing to do, it goes on by itself once the arm rests"
        )
    return None


def _gate(seen: Seen) -> Missing | None:
    if seen.link is not None and seen.link.state == "MIRROR":
        return None  # the arm leads; the gate is closed on purpose
    word = seen.sync or Word("", "no report of pca_monitor")
    state, reason = word.state, word.reason
    if state != "IN_SYNC":
        action = "call reset" if state in ("STOPPED", "FAULT") else "it opens when twin and arm agree"
        return Missing("the gate to open", f"{state or 'silent'}: {reason}", action)
    if seen.execution is None or seen.execution.state == "WAITING":
        return Missing("the executor", seen.execution.reason if seen.execution else "no report", "it follows the gate")
    return None
