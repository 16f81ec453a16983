"""A test that runs processes at 250 Hz and failed while the machine stood still shows nothing, and is run again: a hook of pytest.

For tests with the mark `realtime` and for launch tests. A probe per core (benchmarks/machine.py) watches; a failure beside such a
pause is a warning, one without, or where SCHED_FIFO is not permitted, is a failure. Of several workers each keeps to a core, but
not a launch test.
"""

from __future__ import annotations

import os

import pytest
from _pytest.runner import runtestprotocol
from machine import MachineProbe

#: A failure beside such a pause of a core [ms] shows nothing; runs that are made again at most. The monitor calls a pose stale at
#: 100 ms; pauses of 20 ms are usual on a shared machine, and Linux itself stops real-time processes for 50 ms.
HALT, AGAIN = 60.0, 3
#: Period of the probe [ns], and the highest SCHED_FIFO priority of the nodes, above which it stands.
PERIOD, PRIORITY = 2_000_000, 50


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Run a test at 250 Hz, and again where it failed while a core ran no process."""
    if item.get_closest_marker("realtime") is None:
        return None
    worker = os.environ.get("PYTEST_XDIST_WORKER")
    if worker and isinstance(item, pytest.Function):
        cores = sorted(os.sched_getaffinity(1))
        os.sched_setaffinity(0, {cores[int(worker.removeprefix("gw")) % len(cores)]})
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    with MachineProbe(PRIORITY, PERIOD) as probe:
        for left in range(AGAIN, -1, -1):
            probe.taken()
            reports = runtestprotocol(item, nextitem=nextitem, log=False)
            machine = probe.taken()
            failed = [report for report in reports if report.failed]
            if not failed or machine["longest_ms"] < HALT or not machine["above"] or not left:
                break
            words = "; ".join(str(report.longrepr).strip().splitlines()[-1] for report in failed)
            item.warn(
                pytest.PytestWarning(f"a core ran nothing for {machine['longest_ms']:.0f} ms; once more: {words}")
            )
            if hasattr(item, "_initrequest"):
                item._initrequest()
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True
