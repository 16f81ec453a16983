"""`stop`, `pause`, `resume`, `reset` and `arm` by MQTT, carried out by executor and bridge; part of mqtt_review.

Each verb has a queue and a thread of its own: a stop and a pause wait for nothing else that was asked for. The gateway reads the
same stops itself, so this one brakes along the path what the gateway brakes within its limits, and voids the plans that wait.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import rospy

from construction_twin.core.errors import PayloadError
from construction_twin.core.sentences import Sentence
from construction_twin.mqtt import requests
from construction_twin.mqtt.interventions import Intervention, parse_intervention
from construction_twin.mqtt.messages import Topics
from construction_twin.mqtt.requests import PRESSED, RequestKind
from construction_twin.ros.shared.endpoint import REPEATED, Endpoint, Incoming, Outlets
from construction_twin.ros.shared.outcome import Outcome
from construction_twin.ros.shared.request_counts import RequestCounts
from construction_twin.ros.shared.request_queue import RequestQueue
from construction_twin.ros.transport.persistent_service import call, call_twice

#: What may wait while one is carried out, for each of the verbs.
WAITING = 8
#: Of each verb that starts something, requests that are remembered: QoS 1 may deliver twice, and a recording can be replayed.
MEMORY = 1000
#: Who offers the services, for sentences.
EXECUTOR, BRIDGE = "the executor", "the bridge"
_PROGRAMS = {requests.EXECUTOR: EXECUTOR, requests.BRIDGE: BRIDGE}


@dataclass(frozen=True)
class RemoteInterventions:
    """What takes interventions, and where they wait.

    Attributes:
        queues: Of each verb; a thread for each of them.
    """

    endpoints: tuple[Endpoint[Intervention], ...]
    queues: Mapping[str, RequestQueue]


def remote_interventions(
    topics: Topics, services: Mapping[str, rospy.ServiceProxy], counts: RequestCounts, outlets: Outlets
) -> RemoteInterventions:
    """Return what takes interventions and gives them to who carries them out.

    Args:
        services: Of each verb; one that starts something takes `moment`, and the bridge's the `person`; others may be called twice.
    """
    queues = {kind.name: RequestQueue(WAITING) for kind in PRESSED}

    def start(kind: RequestKind, known: deque[Intervention], wanted: Intervention) -> Outcome:
        if wanted in known:
            # it must not start again what was paused since
            names = {"verb": wanted.verb, "id": repr(wanted.id), "account": wanted.account}
            raise PayloadError(REPEATED, Sentence("link.payload.again", **names))
        known.append(wanted)
        # it asks the master first; when a pause overtakes it, its moment is older than that pause, and it is void
        person = {"person": wanted.account} if kind.by == requests.BRIDGE else {}
        return Outcome.of(call(services[wanted.verb], _PROGRAMS[kind.by], moment=wanted.moment, **person))

    def brake(kind: RequestKind, wanted: Intervention) -> Outcome:
        return Outcome.of(call_twice(services[wanted.verb], _PROGRAMS[kind.by]))

    def endpoint(kind: RequestKind) -> Endpoint[Intervention]:
        read, queue = partial(_read, kind.name), queues[kind.name]
        # each verb remembers its own: the thread of another one may not add to what is looked through
        act = partial(start, kind, deque(maxlen=MEMORY)) if kind.starts else partial(brake, kind)
        return Endpoint(kind, topics, read, act, counts, outlets, _describe, lambda _: queue)

    return RemoteInterventions(tuple(map(endpoint, PRESSED)), queues)


def _read(verb: str, incoming: Incoming) -> Intervention:
    return parse_intervention(verb, incoming.account, incoming.payload, incoming.retained)


def _describe(wanted: Intervention) -> str:
    return f"{wanted.verb} by MQTT account {wanted.account}"
