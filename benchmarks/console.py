"""The console benchmark: `make bench ARGS=console`; writes results/bench/console.json.

A real gateway and a mock arm at 250 Hz, the real broker, the real console, Debian's chromium with the built page; no ROS. What
console_node does is done by a thread here: 25 times a second it writes the arm's newest state as a `view`. So `latency_ms` goes
from the arrival of the arm's state at the PC that says it, over broker, pipe, browser and page, to the moment when the joint
values are applied. It is measured in one page, while the arm moves and the page draws it; the other clients are WebSocket
subscribers that only read. All processes are on this machine, and so is one clock. `frame_ms` is how long a frame holds the page
up: a processor draws here, in place of a graphics chip.
"""

from __future__ import annotations

import argparse
import asyncio
import gzip
import multiprocessing
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.synchronize import Event
from pathlib import Path

import aiohttp
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
for folder in ("benchmarks", "test/support"):
    sys.path.insert(0, str(ROOT / folder))

from console_page import ConsolePage, launch  # noqa: E402
from console_site import PAGE, write_robot_files  # noqa: E402
from link_cell import PREFIX, Cell, Commander, shipped_config  # noqa: E402
from link_world import (  # noqa: E402
    REALTIME,
    World,
    end_in_order,
    environment,
    free_port,
    listens,
    wait_for,
    write_figures,
)
from mqtt_packets import connect, packet, text  # noqa: E402
from playwright.sync_api import sync_playwright  # noqa: E402
from scripted_robot import ScriptedRobot  # noqa: E402

from construction_twin.core.realtime import request_realtime  # noqa: E402
from construction_twin.mqtt.client import Broker  # noqa: E402
from construction_twin.mqtt.joint_string import JointStringCodec  # noqa: E402

#: Numbers of clients at which the latency is measured.
CLIENTS = (1, 5, 20)
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


def subscribe(ready: Event, ended: Event, port: int, count: int) -> None:
    """Be so many clients that read everything of the robot and draw nothing."""
    end_in_order()
    asyncio.run(_subscribe(port, count, ready, ended))


def stream(ready: Event, ended: Event, port: int, realtime: int) -> None:
    """Arm the gateway and stream a motion to it until `ended`; exit code 1 if the arm does not follow then."""
    end_in_order()
    request_realtime(realtime)
    commander = Commander(port, *shipped_config())
    commander.arm()
    ready.set()
    while not ended.is_set():
        commander.stream(0.1)
    commander.close()
    sys.exit(commander.status["state"] != "following")


@contextmanager
def beside(target: Callable[..., None], *args: object) -> Iterator[None]:
    """Run a process of its own beside the block, which nothing here can hold up; RuntimeError if it failed."""
    ready, ended = SPAWN.Event(), SPAWN.Event()
    process = SPAWN.Process(target=target, args=(ready, ended, *args))
    process.start()
    try:
        wait_for(lambda: ready.is_set() or process.exitcode is not None, 60.0, target.__name__)
        yield
    finally:
        ended.set()
        process.join(10.0)
        if process.exitcode is None:
            process.kill()
            process.join()
    if process.exitcode != 0:
        raise RuntimeError(f"{target.__name__} ended with {process.exitcode}: the machine is too busy to measure")


@contextmanager
def everything(realtime: int) -> Iterator[int]:
    """Start broker, gateway, mock arm, console and stream; give the console's port."""
    with tempfile.TemporaryDirectory() as name, World(Path(name)) as world:
        world.start_broker(realtime)
        config, _ = shipped_config()
        Cell(world, config, realtime)
        write_robot_files(Path(name) / "private", (config.robot,))
        port = free_port()
        world.start(
            "console",
            [sys.executable, ROOT / "nodes/console", "--page", PAGE, "--private", Path(name) / "private", "--port", port,
             "--broker-port", world.broker_port],
        )  # fmt: skip
        wait_for(lambda: listens(port), 20.0, "the console listening")
        with beside(stream, world.broker_port, realtime), Relay(world.broker_port):
            yield port


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


def measure_page(port: int, robot: str, seconds: float) -> dict:
    """Return the figures of the page: first picture, latency by number of clients, frame time."""
    found: dict = {"latency_ms": {}, "frame_ms": {}}
    with sync_playwright() as playwright:
        browser = launch(playwright)
        page = ConsolePage(browser, f"http://127.0.0.1:{port}/", picture=True)
        page.context.add_init_script(_APPLIED)
        begin = time.monotonic()
        page.open()
        page.wait_drawn(robot, "document.querySelector('canvas').frames > 0", 60_000)
        found["first_picture_s"] = round(time.monotonic() - begin, 2)
        for clients in CLIENTS:
            with beside(subscribe, port, clients - 1):
                page.page.evaluate("() => { window.applied.length = 0; window.frameTimes.length = 0 }")
                page.page.wait_for_timeout(1000 * seconds)
                latencies = [1000 * (applied - stamp) for stamp, applied in page.page.evaluate("window.applied")]
                frames = page.page.evaluate("window.frameTimes")
            found["latency_ms"][str(clients)] = spread(latencies) | {"views": len(latencies)}
            found["frame_ms"][str(clients)] = spread(frames)
            print(f"[console] {clients} clients: measured", flush=True)
        browser.close()
    return found


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    option = parser.add_argument
    option("--output", type=Path, default=ROOT / "results/bench/console.json", help="file of the figures [%(default)s]")
    option("--seconds", type=float, default=30.0, help="per number of clients [%(default)s]")
    option("--realtime", type=int, default=REALTIME, help="SCHED_FIFO priority where permitted; 0: none [%(default)s]")
    options = parser.parse_args()
    end_in_order()
    result: dict = {"bytes_gzip": page_bytes(PAGE), "environment": environment()}
    with everything(options.realtime) as port:
        result |= measure_page(port, shipped_config()[0].robot, options.seconds)
    write_figures(options.output, result)


if __name__ == "__main__":
    main()
