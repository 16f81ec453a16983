"""Keeps the console's page open and says whether page or console grow: part of `make soak`; `make soak ARGS=console` alone.

A site with mosquitto and the console, robots of a script that speak 25 times a second, the page with its picture in chromium.
Every interval a plan comes and is rejected in own words, the broker is started anew, and a line is printed: the page's JavaScript
heap after a collection, its DOM nodes and listeners, the console's resident memory. `--minutes 2 --interval 10` is a short form
for trying. The exit code is 0 if nothing grows. One node per typed reason is the browser's memory of what was typed, for its undo.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
from dataclasses import astuple, dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
for folder in ("benchmarks", "test/support"):
    sys.path.insert(0, str(ROOT / folder))

from console_page import ConsolePage, launch  # noqa: E402
from console_site import ConsoleSite  # noqa: E402
from link_world import end_in_order, resident_mb  # noqa: E402
from playwright.sync_api import CDPSession, expect, sync_playwright  # noqa: E402

#: What may grow between the first and the last third of a run: heap [MB], nodes, listeners, the console's memory [MB].
MOST = (3.0, 200.0, 100.0, 3.0)
NAMES = ("heap MB", "nodes", "listeners", "console MB")


@dataclass(frozen=True)
class Sample:
    """What is there at one time: heap of the page [MB], its DOM nodes and listeners, the console's resident memory [MB]."""

    heap: float
    nodes: float
    listeners: float
    console: float


def sample(session: CDPSession, console: int) -> Sample:
    """Return what is there now, without what the next collection takes away."""
    session.send("HeapProfiler.collectGarbage")
    values = {each["name"]: each["value"] for each in session.send("Performance.getMetrics")["metrics"]}
    return Sample(values["JSHeapUsedSize"] / 1e6, values["Nodes"], values["JSEventListeners"], resident_mb(console))


def verdict(samples: list[Sample]) -> list[str]:
    """Return a sentence for each value that grew; the first sample, of a page that has just come, does not count."""
    rows = [astuple(each) for each in samples[1:]]
    third = max(1, len(rows) // 3)
    if len(rows) < 3:
        return ["fewer than 4 samples: a run that short shows nothing"]
    wrong = []
    for name, most, column in zip(NAMES, MOST, zip(*rows)):
        growth = statistics.median(column[-third:]) - statistics.median(column[:third])
        if growth > most:
            wrong.append(f"{name} grew by {growth:.1f}; expected at most {most:g}")
    return wrong


def main(arguments: list[str] | None = None) -> int:
    """Keep the page open; return the exit code."""
    parser = argparse.ArgumentParser(description="The console's page for half an hour: memory of page and console.")
    parser.add_argument("--minutes", type=float, default=30.0, help="[%(default)s]")
    parser.add_argument("--interval", type=float, default=60.0, help="of a line [s] [%(default)s]")
    options = parser.parse_args(arguments)
    end_in_order()
    samples: list[Sample] = []
    with tempfile.TemporaryDirectory() as name, sync_playwright() as playwright:
        site = ConsoleSite(Path(name))
        try:
            site.start()
            with site.robot() as robot:
                browser = launch(playwright)
                page = ConsolePage(browser, site.url, picture=True, size=(900, 700)).open()
                page.login("one-reviewer-ada", site.password("one-reviewer-ada"))
                page.wait_drawn("one")
                session = page.context.new_cdp_session(page.page)
                session.send("Performance.enable")
                print(" ".join(f"{each:>12s}" for each in ("minute", *NAMES)), flush=True)
                for number in range(round(60 * options.minutes / options.interval)):
                    robot.show_plan()
                    expect(page.page.locator(".verdict")).to_be_visible()
                    page.reject(f"soak {number}")
                    expect(page.notice).to_contain_text("accepted")
                    site.site.stop()
                    expect(page.lost).to_be_visible()
                    site.site.start()
                    expect(page.lost).to_be_hidden()
                    page.page.wait_for_timeout(1000 * options.interval)
                    expect(page.lost).to_be_hidden()
                    page.forget_uploads()
                    samples.append(sample(session, site.console_pid))
                    figures = [(number + 1) * options.interval / 60, *astuple(samples[-1])]
                    print(" ".join(f"{each:12.1f}" for each in figures), flush=True)
                errors = page.errors
                browser.close()
        finally:
            site.stop()
    wrong = verdict(samples) + [f"the page: {error}" for error in errors]
    for sentence in wrong:
        print(f"WRONG: {sentence}")
    print("nothing grows" if not wrong else f"{len(wrong)} things are wrong")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
