"""`stop`, `pause` and `resume` by MQTT, carried out by the executor and answered there; part of mqtt_review.

Each verb has a thread of its own: a stop and a pause wait for nothing else that was asked for. The gateway reads the same stops
itself, so this one brakes along the path what the gateway brakes within its limits, and voids the plans that wait.

What was asked for is carried out first and answered next; counts come after that (`Beside`), and log lines are left to `write_log`:
the next stop waits for no disk and no terminal.
"""

from __future__ import annotations

import queue
import threading
from collections import Counter, deque
from collections.abc import Callable, Mapping
from functools import partial

import rospy
from paho.mqtt.client import MQTTMessage

from construction_twin.core.beside import Beside
from construction_twin.core.errors import PayloadError
from construction_twin.mqtt.interventions import (
    EXECUTOR,
    PAUSE,
    RESUME,
    STOP,
    Intervention,
    intervention_answer,
    parse_intervention,
)
from construction_twin.mqtt.messages import Topics, account_of
from construction_twin.ros.shared.deferred_log import DeferredLog
from construction_twin.ros.shared.malformed_answers import MalformedAnswers
from construction_twin.ros.transport.persistent_service import NO_ANSWER

#: What may wait while one is carried out, for each of the threads.
WAITING = 8
#: Longest wait for a service of the executor to exist [s].
SERVICE_TIMEOUT = 1.0
#: Resumes that are remembered: QoS 1 may deliver twice, and a recording can be replayed.
MEMORY = 1000


class RemoteInterventions:
    """Takes interventions from MQTT and gives them to the executor.

    Args:
        services: The executor's service per verb, as `rospy.ServiceProxy`; that of `resume` takes `moment`.
        publish: Takes topic and payload.

    Attributes:
        beside: What tells of an intervention, and cannot fail it.
        said: What `write_log` writes.
    """

    def __init__(
        self,
        topics: Topics,
        services: Mapping[str, rospy.ServiceProxy],
        publish: Callable[[str, bytes], object],
    ):
        self.beside = Beside()
        self.said = DeferredLog()
        self._services = services
        self._publish = publish
        self._acks = {STOP: topics.stop_ack, PAUSE: topics.pause_ack, RESUME: topics.pause_ack}
        self._queues: dict[str, queue.Queue[Intervention]] = {verb: queue.Queue(WAITING) for verb in self._acks}
        # a resume asks the master first; when a pause overtakes it, its moment is older than that pause, and it is void
        self._threads = [
            threading.Thread(target=self._run, args=(waiting,), name=verb, daemon=True)
            for verb, waiting in self._queues.items()
        ]
        self._known: deque[Intervention] = deque(maxlen=MEMORY)
        self._lock = threading.Lock()
        self._counts: Counter[str] = Counter()
        self._malformed = MalformedAnswers("interventions")
        #: Counts a refused input; takes reason and sentence.
        self.refuse: Callable[[str, str], None] = lambda reason, sentence: None
        #: What takes the messages of each topic.
        self.on_message: dict[str, Callable[[MQTTMessage], None]] = {
            topic("+"): partial(self._take, verb)
            for verb, topic in ((STOP, topics.stop_by), (PAUSE, topics.pause_by), (RESUME, topics.resume_by))
        }

    def start(self) -> None:
        """Begin to carry out."""
        for thread in self._threads:
            thread.start()

    def report(self) -> dict[str, int]:
        """Return the counts for `/diagnostics`."""
        with self._lock:
            counts = {f"interventions {name}": count for name, count in sorted(self._counts.items())}
        return counts | self._malformed.report()

    def write_log(self) -> None:
        """Write what is to be said, and what has failed; for a thread that may wait for a disk or a terminal."""
        self.beside.do("the log", self.said.flush)
        self.beside.tell(rospy.logerr)

    def say(self, *line: object) -> None:
        """Have a line written by `write_log`."""
        self.beside.do("the log", self.said.add, rospy.loginfo, *line)

    def _take(self, verb: str, message: MQTTMessage) -> None:
        account = id_ = ""
        try:
            account = account_of(message.topic)
            if not account:
                # an answer, of this node or of the gateway
                return
            wanted = parse_intervention(verb, account, bytes(message.payload), message.retain)
            id_ = wanted.id
            if verb == RESUME:
                self._check_new(wanted)
            self._queues[verb].put_nowait(wanted)
            if verb == RESUME:
                self._known.append(wanted)
        except PayloadError as error:
            self.refuse(error.reason, str(error))
            # one that came before was answered then
            if error.reason != "repeated" and self._malformed.take(account):
                self._answer(verb, id_, account, False, str(error))
        except queue.Full:
            sentence = f"{WAITING} are waiting already; try again"
            self._answer(verb, id_, account, False, sentence)
            self.beside.do("the count of refusals", self.refuse, "busy", f"{verb}: {sentence}")

    def _check_new(self, wanted: Intervention) -> None:
        """Refuse one that came before (PayloadError): a `resume` must not start again what was paused since."""
        if wanted in self._known:
            raise PayloadError("repeated", f"{wanted.verb} {wanted.id!r} of account {wanted.account} came before")

    def _run(self, waiting: queue.Queue[Intervention]) -> None:
        while not rospy.is_shutdown():
            try:
                self._carry_out(waiting.get(timeout=0.2))
            except queue.Empty:
                continue

    def _carry_out(self, wanted: Intervention) -> None:
        service = self._services[wanted.verb]
        try:
            answer = self._call(service, wanted)
            ok, sentence = answer.success, answer.message
            expired = wanted.verb == RESUME and answer.expired
        except (rospy.ROSException, *NO_ANSWER) as error:
            ok, expired = False, False
            sentence = f"{service.resolved_name} does not answer: {error}; does the executor run?"
        self.beside.do("the answer", self._answer, wanted.verb, wanted.id, wanted.account, ok, sentence, expired)
        with self._lock:
            self._counts["taken" if ok else "not taken"] += 1
        self.say("%s by MQTT account %s: %s", wanted.verb, wanted.account, sentence)

    @staticmethod
    def _call(service: rospy.ServiceProxy, wanted: Intervention):
        if wanted.verb != RESUME:
            # over the connection that is open: no master is asked before a stop or a pause, which may come twice
            try:
                return service()
            except NO_ANSWER:
                # the executor may just be starting
                pass
        rospy.wait_for_service(service.resolved_name, SERVICE_TIMEOUT)
        return service(moment=wanted.moment) if wanted.verb == RESUME else service()

    def _answer(self, verb: str, id_: str, account: str, ok: bool, sentence: str, expired: bool = False) -> None:
        self._publish(self._acks[verb], intervention_answer(id_, account, EXECUTOR, ok, sentence, expired))
