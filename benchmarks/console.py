"""The console benchmark: `make bench ARGS=console`; writes results/bench/console.json.

A real gateway and a mock arm at 250 Hz, the real broker, the real console, Debian's chromium with the built page; no ROS. What
console_node does is done by a thread here: 25 times a second it writes the arm's newest state as a `view`. So `latency_ms` goes
from the arrival of the arm's state at the PC that says it, over broker, pipe, browser and page, to the moment when the joint
values are applied. It is measured in one page, while the arm moves and the page draws it; the other clients are WebSocket
subscribers that only read. All processes are on this machine, and so is one clock. `frame_ms` is how long a frame holds the page
up: a processor draws here, in place of a graphics chip.

`link_p99_ratio` compares the time from a command to the arm's answer to it, over MQTT, with 5 such clients and without, in turns.
`broker_gone_shown_s` is the time from the end of a site's broker to the page's line that nothing is connected.
"""

from __future__ import annotations

import argparse
import asyncio
import gzip
import json
import multiprocessing
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.synchronize import Event
from pathlib import Path

import aiohttp
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
for folder in ("benchmarks", "test/support"):
    sys.path.insert(0, str(ROOT / folder))

from console_page import ConsolePage, launch  # noqa: E402
from console_site import PAGE, ConsoleSite, write_robot_files  # noqa: E402
from link_cell import Cell, Commander, shipped_config  # noqa: E402
from link_world import (  # noqa: E402
    REALTIME,
    World,
    cpu_seconds,
    end_in_order,
    environment,
    free_port,
    listens,
    wait_for,
)
from mqtt_packets import connect, packet, text  # noqa: E402
from playwright.sync_api import sync_playwright  # noqa: E402
from scripted_robot import ScriptedRobot  # noqa: E402

from construction_twin.core.realtime import request_realtime  # noqa: E402
from construction_twin.mqtt.client import Broker  # noqa: E402
from construction_twin.mqtt.joint_string import JointStringCodec  # noqa: E402
from construction_twin.mqtt.messages import StateProperties  # noqa: E402

#: Numbers of clients at which the latency is measured, and at which the link is.
CLIENTS, LINK_CLIENTS = (1, 5, 20), 5
#: How often a broker is ended and started again.
LOSSES = 5
PREFIX = "twin"
#: Processes that begin anew: a copy of this one would have its real time and its sockets.
SPAWN = multiprocessing.get_context("spawn")

#: Notes when the joint values of a view are applied: all that a view causes happens before the next microtask. And how long each
#: frame held the page up.
_APPLIED = """
(() => {
  const parse = JSON.parse;
  window.applied = [];
  JSON.parse = (text, ...rest) => {
    const value = parse(text, ...rest);
    if (value?.arm?.stamp !== undefined && value?.run !== undefined) {
      queueMicrotask(() => window.applied.push([value.arm.stamp, (performance.timeOrigin + performance.now()) / 1000]));
    }
    return value;
  };
  window.frameTimes = [];
  const count = () => {
    const canvas = document.querySelector("canvas");
    if (canvas?.frames > counted) window.frameTimes.push(canvas.frameTime);
    counted = canvas?.frames ?? 0;
    requestAnimationFrame(count);
  };
  let counted = 0;
  requestAnimationFrame(count);
})();
"""


class Relay(ScriptedRobot):
    """Says the arm's state as console_node does: the newest one that has come, 25 times a second.

    Args:
        port: Of the broker.
    """

    def __init__(self, port: int):
        config, home = shipped_config()
        codec = JointStringCodec(len(home), config.decimals)
        super().__init__(Broker(port=port), config.robot, PREFIX)

        def on_state(payload: bytes) -> None:
            self.arm_stamp, self.twin = time.time(), np.array(codec.decode(payload))

        self.listen("state", on_state)


class AnswerTimes:
    """From a command's stamp to the arm's first answer to it [ns]."""

    def __init__(self):
        self._times: list[int] = []
        self._last = 0

    def add(self, state: StateProperties) -> None:
        """Take a state that has just come."""
        if state.command_stamp > self._last:
            self._last = state.command_stamp
            self._times.append(time.monotonic_ns() - state.command_stamp)

    def taken(self) -> list[int]:
        """Return those since the last call."""
        taken, self._times = self._times, []
        return taken


async def _subscribe(port: int, count: int, ready: Event, ended: Event) -> None:
    """Let clients read everything of the robot until `ended`; a client that is cut off ends all."""
    url, origin = f"ws://127.0.0.1:{port}/mqtt", f"http://127.0.0.1:{port}"
    topics = b"".join(text(f"{PREFIX}/+/{topic}") + b"\0" for topic in ("view", "screen", "plan", "scene"))

    async def read(number: int) -> None:
        # addresses of their own, as tablets have
        connector = aiohttp.TCPConnector(local_addr=(f"127.0.1.{number + 1}", 0))
        async with (
            aiohttp.ClientSession(connector=connector) as session,
            session.ws_connect(url, origin=origin, protocols=["mqtt"], max_msg_size=0) as client,
        ):
            # and names of their own: the broker ends the older of two clients of one name
            await client.send_bytes(connect(client=f"subscriber-{number}"))
            await client.receive_bytes()
            await client.send_bytes(packet(8, b"\0\x01\0" + topics, flags=2))
            await client.receive_bytes()
            begun.append(number)
            pinged = time.monotonic()
            async for _ in client:
                # within the broker's keep-alive of 10 s
                if time.monotonic() - pinged > 3.0:
                    pinged = time.monotonic()
                    await client.send_bytes(packet(12))

    async def watch() -> None:
        while not ended.is_set():
            if len(begun) == count:
                ready.set()
            await asyncio.sleep(0.1)

    begun: list[int] = []
    tasks = [asyncio.create_task(read(number)) for number in range(count)]
    watching = asyncio.create_task(watch())
    await asyncio.wait([watching, *tasks], return_when=asyncio.FIRST_COMPLETED)
    for task in tasks:
        if task.done():
            raise RuntimeError("the console has cut a subscriber off") from task.exception()
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


def subscribe(port: int, count: int, ready: Event, ended: Event) -> None:
    """Be so many clients that read everything of the robot and draw nothing."""
    end_in_order()
    asyncio.run(_subscribe(port, count, ready, ended))


def stream(port: int, realtime: int, calls: Connection) -> None:
    """Arm the gateway and stream to it until told to end; answers each call with the state and the answer times since the last."""
    end_in_order()
    request_realtime(realtime)
    answers = AnswerTimes()
    config, home = shipped_config()
    commander = Commander(port, config, home, PREFIX, answers.add)
    commander.arm()
    calls.send((commander.status, []))
    going = True
    while going:
        commander.stream(0.1)
        if calls.poll():
            going = calls.recv()
            calls.send((commander.status, answers.taken()))
    commander.close()


class Arm:
    """An arm that moves: the stream to it comes from a process of its own, which nothing here can hold up.

    Args:
        port: Of the broker.
        realtime: SCHED_FIFO priority of the stream.
    """

    def __init__(self, port: int, realtime: int):
        self._calls, theirs = SPAWN.Pipe()
        self._process = SPAWN.Process(target=stream, args=(port, realtime, theirs))
        self._process.start()
        theirs.close()

    def __enter__(self) -> Arm:
        if not self._calls.poll(60.0):
            raise TimeoutError("the arm was not armed within 60 s")
        self._calls.recv()
        return self

    def __exit__(self, *_) -> None:
        if self._process.is_alive():
            self._calls.send(False)
            self._process.join(10.0)
        if self._process.exitcode is None:
            self._process.kill()
        self._process.join()

    def answers(self) -> list[int]:
        """Return the answer times since the last call [ns]; RuntimeError if the arm does not follow: then it does not move."""
        self._calls.send(True)
        status, times = self._calls.recv()
        if status["state"] != "following":
            raise RuntimeError(f"the arm has stopped: {status['reason']}; the machine is too busy to measure")
        return times


@contextmanager
def subscribers(port: int, count: int) -> Iterator[None]:
    """Let so many clients read in a process of their own while the block runs."""
    ready, ended = SPAWN.Event(), SPAWN.Event()
    process = SPAWN.Process(target=subscribe, args=(port, count, ready, ended))
    process.start()
    try:
        wait_for(lambda: ready.is_set() or process.exitcode is not None, 30.0, "the subscribers")
        yield
    finally:
        ended.set()
        process.join(10.0)
        if process.exitcode is None:
            process.kill()
            process.join()
    if process.exitcode != 0:
        raise RuntimeError(f"the subscribers ended with {process.exitcode}: the figures are not those of {count}")


@contextmanager
def everything(realtime: int) -> Iterator[tuple[int, int, int, Arm]]:
    """Start broker, gateway, mock arm, console, stream; give the broker's port, the console's, its process id, and the arm."""
    with tempfile.TemporaryDirectory() as name, World(Path(name)) as world:
        world.start_broker(realtime)
        config, _ = shipped_config()
        Cell(world, config, realtime, PREFIX)
        write_robot_files(Path(name) / "private", (config.robot,))
        port = free_port()
        console = world.start(
            "console",
            [sys.executable, ROOT / "nodes/console", "--page", PAGE, "--private", Path(name) / "private", "--port", port,
             "--broker-port", world.broker_port],
        )  # fmt: skip
        wait_for(lambda: listens(port), 20.0, "the console listening")
        with Arm(world.broker_port, realtime) as arm:
            yield world.broker_port, port, console.pid, arm


def spread(values: Sequence[float]) -> dict:
    """Return median and 99th percentile, in the values' unit."""
    return {"p50": round(float(np.percentile(values, 50)), 2), "p99": round(float(np.percentile(values, 99)), 2)}


def page_bytes(page: Path) -> int:
    """Return what a browser in German loads of the page, compressed, without what belongs to a robot: in English it is less."""
    return sum(
        len(gzip.compress(file.read_bytes(), 6, mtime=0))
        for file in page.iterdir()
        if file.suffix in (".html", ".js", ".css", ".svg") or file.match("sentences.de.*.json")
    )


def measure_page(port: int, console: int, robot: str, seconds: float, arm: Arm) -> dict:
    """Return the figures of page and pipe: first picture, latency by number of clients, frame time, processor time."""
    found: dict = {"latency_ms": {}, "pipe_cpu": {}, "frames_per_s": {}, "frame_ms": {}}
    with sync_playwright() as playwright:
        browser = launch(playwright)
        page = ConsolePage(browser, f"http://127.0.0.1:{port}/", picture=True)
        page.context.add_init_script(_APPLIED)
        begin = time.monotonic()
        page.open()
        page.wait_drawn(robot, "document.querySelector('canvas').frames > 0", 60_000)
        found["first_picture_s"] = round(time.monotonic() - begin, 2)
        for clients in CLIENTS:
            with subscribers(port, clients - 1):
                page.page.evaluate("() => { window.applied.length = 0; window.frameTimes.length = 0 }")
                used, begin = cpu_seconds(console), time.monotonic()
                page.page.wait_for_timeout(1000 * seconds)
                passed = time.monotonic() - begin
                used = (cpu_seconds(console) - used) / passed
                latencies = [1000 * (applied - stamp) for stamp, applied in page.page.evaluate("window.applied")]
                frames = page.page.evaluate("window.frameTimes")
            # it has moved all the time
            arm.answers()
            name = str(clients)
            found["latency_ms"][name] = spread(latencies) | {"views": len(latencies)}
            found["pipe_cpu"][name] = round(used, 4)
            found["frames_per_s"][name] = round(len(frames) / passed, 1)
            found["frame_ms"][name] = spread(frames)
            print(
                f"[console] {clients} clients: {found['latency_ms'][name]}, frames: {found['frame_ms'][name]}",
                flush=True,
            )
        # what one more client costs: the page is one of them in each
        few, many = CLIENTS[0], CLIENTS[-1]
        found["pipe_cpu_per_client"] = round(
            (found["pipe_cpu"][str(many)] - found["pipe_cpu"][str(few)]) / (many - few), 4
        )
        browser.close()
    return found


def measure_loss(times: int) -> dict:
    """Return how long it takes until a page of a site with accounts shows that the broker is gone, and that it is back [s]."""
    gone, back = [], []
    with tempfile.TemporaryDirectory() as name, sync_playwright() as playwright:
        site = ConsoleSite(Path(name))
        try:
            site.start()
            with site.robot():
                browser = launch(playwright)
                page = ConsolePage(browser, site.url, picture=True).open()
                page.login("ada", site.password("ada"))
                page.wait_drawn("one")
                for _ in range(times):
                    begin = time.monotonic()
                    site.site.stop()
                    page.lost.wait_for(state="visible")
                    gone.append(round(time.monotonic() - begin, 3))
                    site.site.start()
                    begin = time.monotonic()
                    page.lost.wait_for(state="hidden")
                    back.append(round(time.monotonic() - begin, 3))
                browser.close()
        finally:
            site.stop()
    return {"broker_gone_shown_s": gone, "broker_back_shown_s": back}


def measure_link(arm: Arm, port: int, rounds: int, seconds: float) -> dict:
    """Return the arm's answer times with clients and without, in turns, and their ratio."""
    taken: dict[bool, list[float]] = {False: [], True: []}
    for number in range(rounds):
        for with_clients in (False, True) if number % 2 == 0 else (True, False):
            with subscribers(port, LINK_CLIENTS if with_clients else 0):
                # what starting them has cost is not counted
                time.sleep(1.0)
                arm.answers()
                time.sleep(seconds)
                taken[with_clients].append(float(np.percentile(arm.answers(), 99)) / 1e6)
            print(
                f"[console] link {'with' if with_clients else 'without'} clients: {taken[with_clients][-1]:.2f} ms",
                flush=True,
            )
    middle = {with_clients: statistics.median(values) for with_clients, values in taken.items()}
    return {
        "link_p99_ratio": round(middle[True] / middle[False], 3),
        "link_p99_ms": {"without": [round(value, 3) for value in taken[False]], "with": [round(value, 3) for value in taken[True]]},
    }  # fmt: skip


def read_options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the command line's options."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    option = parser.add_argument
    option("--output", type=Path, default=ROOT / "results/bench/console.json", help="file of the figures [%(default)s]")
    option("--seconds", type=float, default=30.0, help="per number of clients [%(default)s]")
    option("--rounds", type=int, default=5, help="of the link, with and without clients [%(default)s]")
    option("--link-seconds", type=float, default=20.0, help="per round and turn [%(default)s]")
    option("--realtime", type=int, default=REALTIME, help="SCHED_FIFO priority where permitted; 0: none [%(default)s]")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print, write; return the exit code."""
    options = read_options(arguments)
    end_in_order()
    result: dict = {"bytes_gzip": page_bytes(PAGE)}
    before = environment()
    with everything(options.realtime) as (broker_port, port, console, arm), Relay(broker_port):
        result |= measure_page(port, console, shipped_config()[0].robot, options.seconds, arm)
        result |= measure_link(arm, port, options.rounds, options.link_seconds)
    result |= measure_loss(LOSSES)
    result["environment"] = before | {"load_after": environment()["load"]}
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(json.dumps(result, indent=2) + "\n")
    print(json.dumps(result, indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
