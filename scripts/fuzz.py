"""Fuzzes codecs, the console's page and running gateway: `python scripts/fuzz.py [--count 1000000] [--seed 1] [--part codecs]`.

Same seed, same inputs.

Ends with 0 when nothing crashed, nothing moved, everything was counted and memory stayed flat; otherwise with 1 and a sentence.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "test" / "fuzz"), str(ROOT / "test" / "support")]

from fuzz_codecs import mqtt_codecs, rsi_codecs  # noqa: E402
from fuzz_gateway import Arm, Cycling, GatewayProcess, Mqtt, Refused, demand, flood_mqtt, flood_rsi  # noqa: E402
from processes import BrokerProcess, wait_until  # noqa: E402

#: The process may have grown by this much after the first tenth [bytes]: allocator noise, not what was sent.
GROWTH = 4 << 20
#: The status must stay this small, whatever it quotes [bytes].
STATUS = 8192


@dataclass
class Row:
    """One campaign's result; memory in bytes, None where there is no process of its own."""

    name: str
    sent: int
    counts: Counter
    seconds: float
    memory: tuple[int, int] | None = None


def progress_of(name: str, count: int) -> Callable[[int], None]:
    """Return a function that prints how far a campaign is, ten times in all."""
    step, began = max(1, count // 10), time.monotonic()
    shown = [0]

    def show(done: int) -> None:
        if done // step > shown[0]:
            shown[0] = done // step
            print(f"[fuzz] {name}: {done} of {count}, {done / (time.monotonic() - began):.0f}/s", flush=True)

    return show


def run_codecs(count: int, seed: int) -> list[Row]:
    """Run the codecs' two campaigns."""
    began = time.monotonic()
    rows = [Row("MQTT codecs", count, mqtt_codecs(count, seed, progress_of("MQTT codecs", count)), 0.0)]
    rows[0].seconds = time.monotonic() - began
    arm = Arm(("127.0.0.1", 9))
    packet = arm.controller.begin_cycle()
    arm.close()
    began = time.monotonic()
    tally = rsi_codecs(packet, count, seed, progress_of("RSI codecs", count))
    return [*rows, Row("RSI codecs", count, tally, time.monotonic() - began)]


def run_page(count: int, seed: int) -> list[Row]:
    """Run the campaign of what the console's page makes of messages; needs node, which the console's page is built with.

    Raises:
        Refused: When it threw, or kept what it may not.
    """
    node = shutil.which("node")
    if node is None:
        print("[fuzz] no node here: the page's campaign is left out; `setup/setup.sh console` installs it", flush=True)
        return []
    began = time.monotonic()
    command = [node, str(ROOT / "test/fuzz/fuzz_page.mjs"), str(count), str(seed)]
    ended = subprocess.run(command, capture_output=True, text=True)
    demand(ended.returncode == 0, f"the console's page: {ended.stderr[-2000:]}")
    return [Row("messages, page", count, Counter(json.loads(ended.stdout)), time.monotonic() - began)]


def run_gateway(count: int, seed: int, folder: Path) -> list[Row]:
    """Run the running gateway's two campaigns, on a broker and a gateway of their own.

    Raises:
        Refused: When it did not stand up to them.
    """
    broker = BrokerProcess()
    broker.start()
    gateway = GatewayProcess(folder, broker.port)
    arm = Arm(gateway.address)
    try:
        mqtt = Mqtt(broker.port)
        wait_until(lambda: arm.cycle(), 10.0, "a reply of the gateway")
        rows = [_mqtt_row(gateway, arm, mqtt, count, seed), _rsi_row(gateway, arm, mqtt, count, seed)]
        demand(mqtt.largest_status <= STATUS, f"the status grew to {mqtt.largest_status} bytes")
        mqtt.close()
        gateway.end()
    finally:
        arm.close()
        gateway.kill()
        broker.kill()
    return rows


def _mqtt_row(gateway: GatewayProcess, arm: Arm, mqtt: Mqtt, count: int, seed: int) -> Row:
    def flood(count: int, seed: int, progress: Callable[[int], None] = lambda done: None) -> Counter:
        with Cycling(arm):
            return flood_mqtt(mqtt, count, seed, progress)

    return flooded("MQTT, running gateway", gateway, arm, flood, count, seed)


def _rsi_row(gateway: GatewayProcess, arm: Arm, mqtt: Mqtt, count: int, seed: int) -> Row:
    def flood(count: int, seed: int, progress: Callable[[int], None] = lambda done: None) -> Counter:
        return flood_rsi(arm, mqtt, count, seed, progress)

    return flooded("RSI, running gateway", gateway, arm, flood, count, seed)


def flooded(name: str, gateway: GatewayProcess, arm: Arm, flood: Callable[..., Counter], count: int, seed: int) -> Row:
    """Run a tenth to warm up, then all; judge motion, life and memory."""
    flood(count // 10, seed + 1)
    before, began = gateway.resident(), time.monotonic()
    counts = flood(count, seed, progress_of(name, count))
    row = Row(name, count, counts, time.monotonic() - began, (before, gateway.resident()))
    demand(gateway.alive, "the gateway has ended")
    arm.demand_at_home()
    growth = row.memory[1] - row.memory[0]
    demand(growth <= GROWTH, f"{name}: the gateway grew by {growth / 1e6:.1f} MB; allowed are {GROWTH / 1e6:.1f} MB")
    return row


def table(rows: list[Row]) -> str:
    """Return the results as text."""
    lines = []
    for row in rows:
        memory = "" if row.memory is None else "   RSS {:.1f} -> {:.1f} MB".format(*(size / 1e6 for size in row.memory))
        lines.append(f"{row.name:22} {row.sent:9} sent   {row.sent / max(row.seconds, 1e-9):7.0f}/s{memory}")
        lines += [f"    {name:28} {number:9}" for name, number in sorted(row.counts.items()) if number]
    return "\n".join(lines)


def main(arguments: list[str]) -> int:
    """Run every campaign; return the exit code."""
    parser = argparse.ArgumentParser(prog="make fuzz", description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=1_000_000, help="inputs per campaign [%(default)s]")
    parser.add_argument("--seed", type=int, default=1, help="of every random choice [%(default)s]")
    parser.add_argument("--part", choices=["codecs", "page", "gateway"], help="only this part [all]")
    options = parser.parse_args(arguments)
    folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
    try:
        rows = run_codecs(options.count, options.seed) if options.part in (None, "codecs") else []
        rows += run_page(options.count, options.seed) if options.part in (None, "page") else []
        rows += run_gateway(options.count, options.seed, folder) if options.part in (None, "gateway") else []
    except Refused as refused:
        print(f"[fuzz] FAILED with seed {options.seed}: {refused}; log in {folder}", flush=True)
        return 1
    print(table(rows))
    print("nothing crashed, nothing moved, everything was counted, memory stayed flat")
    shutil.rmtree(folder)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
