"""Real-time scheduling: in a process of its own, so that the test run itself is never at that priority."""

import subprocess
import sys

from construction_twin.core.realtime import request_realtime

SCRIPT = """
import os, threading
from construction_twin.core.realtime import release_realtime, request_realtime
end = threading.Event()
threading.Thread(target=end.wait, daemon=True).start()
policies = lambda: {os.sched_getscheduler(int(thread)) for thread in os.listdir("/proc/self/task")}
paths = lambda: map("/proc/self/fd/{}".format, os.listdir("/proc/self/fd"))
open_files = lambda: [os.readlink(path) for path in paths() if os.path.islink(path)]
for _ in range(2):
    said = request_realtime(1)
    permitted = said.startswith("SCHED_FIFO 1, ")
    assert not permitted or policies() == {os.SCHED_FIFO}, policies()
    assert open_files().count("/dev/cpu_dma_latency") == ("stay awake" in said), said
    assert not permitted or "stay awake" in said or "may sleep (/dev/cpu_dma_latency: " in said, said
release_realtime()
assert policies() == {os.SCHED_OTHER}, policies()
assert "/dev/cpu_dma_latency" not in open_files()
"""


BECOMES = """
import os, sys
from construction_twin.core.realtime import request_realtime
print(request_realtime(1), flush=True)
os.execvp("ls", ["ls", "-l", "/proc/self/fd"])
"""


def test_every_thread_is_raised_and_released():
    subprocess.run([sys.executable, "-c", SCRIPT], check=True, timeout=30)


def test_priority_zero_asks_for_nothing():
    assert request_realtime(0) == "normal scheduling"


def test_memory_is_locked_where_permitted_and_the_sentence_is_true():
    code = "from construction_twin.core.realtime import lock_memory; print(lock_memory()); print(open('/proc/self/status').read())"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    locked = int(said.split("VmLck:")[1].split()[0])
    assert said.startswith("memory locked\n") if locked else said.startswith("memory not locked (")


def test_a_program_that_takes_the_place_keeps_the_processors_awake():
    said = subprocess.run([sys.executable, "-c", BECOMES], capture_output=True, text=True, check=True).stdout
    first, files = said.split("\n", 1)
    assert ("stay awake" in first) == ("/dev/cpu_dma_latency" in files)
