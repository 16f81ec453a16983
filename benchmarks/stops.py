"""How long a stop by MQTT takes while the node that takes it is flooded; writes results/bench/stops.json.

``python benchmarks/stops.py`` (`make bench ARGS=stops`) brings up the whole system with the mock arm. Times go from the message
`stop/<account>` to the executor's answer [ms], one stop after the other: `quiet`; `motions`, while motions of 2 MiB come from
elsewhere and `view` 25 times a second (`views_per_s`). The law: 99 of 100 within 100 ms.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import threading
import time
from collections import Counter
from multiprocessing.synchronize import Event
from pathlib import Path

import numpy as np
from link_world import ROOT, end_in_order, environment, write_figures
from start import launched

from construction_twin.mqtt.client import Broker, make_client
from construction_twin.mqtt.fast_client import FastClient

TOPIC = "twin/kr120/"
#: Of a motion that is nearly as long as config/console_node.yaml allows.
POINTS = 20_000
JOINTS = [f"joint_a{number}" for number in range(1, 7)]
SPAWN = multiprocessing.get_context("spawn")


def connected(port: int, name: str) -> FastClient:
    """Return a client that is connected."""
    client = make_client(Broker(port=port), f"bench-{name}", f"{TOPIC}bench", "", will_retained=False)
    up = threading.Event()
    client.on_connect = lambda *_: up.set()
    client.connect_async("127.0.0.1", port)
    client.loop_start()
    if not up.wait(30.0):
        raise TimeoutError("no broker")
    return client


def flood(port: int, ended: Event, counts: multiprocessing.Queue) -> None:
    """Send a motion every second, and count views, until `ended`."""
    end_in_order()
    client, seen = connected(port, "flood"), Counter()
    client.message_callback_add(f"{TOPIC}view", lambda *_: seen.update(["views"]))
    client.subscribe(f"{TOPIC}view", 0)
    motion = {"units": {"angle": "rad", "length": "m", "time": "s"}, "joint_names": JOINTS}
    motion["points"] = [{"positions": [0.1] * 6, "time_from_start": k * 0.004} for k in range(POINTS)]
    begin, step = time.monotonic(), 0
    while not ended.is_set():
        client.publish(f"{TOPIC}trajectory/from/bench", json.dumps(motion | {"id": str(step)}), qos=1)
        step += 1
        time.sleep(max(0.0, begin + step - time.monotonic()))
    passed = time.monotonic() - begin
    counts.put({f"{name}_per_s": round(count / passed, 1) for name, count in sorted(seen.items())})
    client.disconnect()


def stop_times(port: int, count: int) -> dict[str, float]:
    """Return how long so many stops took [ms]."""
    client, answered, times = connected(port, "stop"), threading.Event(), []
    wanted = [""]

    def on_answer(_client, _data, message) -> None:
        answer = json.loads(message.payload)
        if answer["by"] == "executor" and answer["id"] == wanted[0]:
            answered.set()

    client.message_callback_add(f"{TOPIC}stop/ack", on_answer)
    client.subscribe(f"{TOPIC}stop/ack", 1)
    time.sleep(1.0)
    for number in range(count):
        wanted[0] = str(number)
        answered.clear()
        begin = time.monotonic()
        client.publish(f"{TOPIC}stop/bench", json.dumps({"id": wanted[0]}), qos=1)
        if not answered.wait(10.0):
            raise TimeoutError("a stop was not answered within 10 s")
        times.append(1000 * (time.monotonic() - begin))
        time.sleep(0.05)
    client.disconnect()
    named = {"p50": 50, "p99": 99, "max": 100}
    return {name: round(float(np.percentile(times, share)), 2) for name, share in named.items()}


def flooded(port: int, count: int) -> dict:
    """Return the times of stops during a flood, and what that was."""
    ended, counts = SPAWN.Event(), SPAWN.Queue()
    process = SPAWN.Process(target=flood, args=(port, ended, counts))
    process.start()
    time.sleep(5.0)
    found = stop_times(port, count)
    ended.set()
    found |= counts.get(timeout=30.0)
    process.join()
    return found


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=ROOT / "results/bench/stops.json", help="[%(default)s]")
    parser.add_argument("--stops", type=int, default=400, help="of each kind [%(default)s]")
    options = parser.parse_args()
    end_in_order()
    result: dict = {"environment": environment()}
    with launched(("console:=files", "gui:=false")) as launch:
        launch.await_line("ready; plan with")
        port = launch.broker_port
        result["quiet"] = stop_times(port, options.stops)
        result["motions"] = flooded(port, options.stops)
    write_figures(options.output, result)


if __name__ == "__main__":
    main()
