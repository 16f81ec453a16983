"""The gateway as a program: its options, its last will, its end, and what it imports."""

from __future__ import annotations

import itertools
import math
import os
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest
from mock_cell import gateway_config, mock_at, swing
from paho.mqtt import client as paho
from processes import ROOT, wait_until
from service_cell import (
    CONFIG,
    PATIENT,
    cell,
    client_of,
    controller_of,
    motion,
    stream,
)

from construction_twin.core.network import bind
from construction_twin.core.units import CYCLE, format_allowance
from construction_twin.mqtt.fast_client import TESTED_VERSIONS
from construction_twin.mqtt.joint_string import JointStringCodec

pytestmark = pytest.mark.realtime


@pytest.fixture
def config_file(tmp_path):
    path = tmp_path / "arm.json"
    path.write_text(CONFIG.to_json())
    return str(path)


def command(*options, code=""):
    """Return how the gateway's program is started, or code in its place."""
    return [sys.executable, *(("-c", code) if code else ("-m", "construction_twin.gateway")), *options]


def refused(*options, code=""):
    """Return the one sentence with which the program does not start."""
    result = subprocess.run(command(*options, code=code), capture_output=True, text=True, timeout=60.0)
    assert result.returncode == 2 and "Traceback" not in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    return result.stderr


@contextmanager
def program(config_file, port, topics, *options, code="", address=("127.0.0.1", 0)):
    """The gateway as a process of its own; yields it and its UDP address."""
    with bind(*address) as sock:
        address = sock.getsockname()
    ends = ["--listen", f"{address[0]}:{address[1]}", "--broker", f"127.0.0.1:{port}", "--prefix", topics.prefix]
    process = subprocess.Popen(
        command("--config", config_file, *ends, *options, code=code), stderr=subprocess.PIPE, text=True
    )
    try:
        yield process, address
    finally:
        process.kill()
        process.communicate(timeout=10.0)


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGTERM])
def test_a_stop_that_nobody_has_reset_outlasts_the_program_whoever_heard_it(broker, topics, config_file, end):
    """Law 5: no bridge runs here, and the gateway is started again."""
    file, runs = Path(config_file).with_name("arm.stopped"), []

    @contextmanager
    def started(client):
        with program(config_file, broker, topics) as (process, address), controller_of(address) as controller:
            controller.start()
            # whatever its cycle is on a loaded machine
            wait_until(
                lambda: client.status().get("run") not in (None, *runs) and client.status()["state"] != "no_controller"
            )
            runs.append(client.status()["run"])
            yield client.status()
            process.send_signal(end)
            controller.send_until(lambda: process.poll() is not None)

    with client_of(broker, topics) as client:
        with started(client):
            client.paho.publish(topics.stop_by("anna"), b'{"id": "1"}', qos=1)
            wait_until(lambda: "account anna" in file.read_text(), what="the stop on the disk")
        with started(client) as status:
            assert status["fault"] and status["fault_number"] == 1
        with started(client) as status:
            assert status["fault"] and client.control("reset")["ok"]
            wait_until(lambda: not file.read_text().strip(), what="that it was reset on the disk")
        with started(client) as status:
            assert not status["fault"]


def test_a_killed_gateway_is_declared_offline_by_its_last_will(broker, topics, config_file):
    with client_of(broker, topics) as client, program(config_file, broker, topics) as (process, _):
        client.wait_for_status(state="no_controller")
        process.kill()
        client.wait_for_status(state="offline", reason="connection lost")
    with client_of(broker, topics) as late:
        late.wait_for_status(state="offline")


def test_a_killed_gateway_joins_the_running_session_answers_nothing_and_waits_for_the_next(broker, topics, tmp_path):
    """Law 2; the controller waits 10 s for a reply, so the program is there again before its session ends."""
    file, config = tmp_path / "arm.json", gateway_config(timeout=10.0)
    file.write_text(config.to_json())
    with bind("127.0.0.1", 0) as sock:
        address = sock.getsockname()
    with mock_at(address, timeout=2500) as (mock, cycles), client_of(broker, topics) as client:
        client.codec = JointStringCodec.of_config(config)
        with program(str(file), broker, topics, address=address) as (process, _):
            client.wait_for_status(state="ready")
            assert client.arm(config, run=client.status()["run"])["ok"]
            stream(client, cycles, (swing(k) for k in range(150)))
            wait_until(lambda: cycles.replies[-1].correction[0] > 0.02, what="the arm to be away from its origin")
            process.kill()
            process.wait()
        killed = len(cycles.replies)
        client.wait_for_status(state="offline")
        with program(str(file), broker, topics, address=address):
            client.wait_for_status(state="joined_running")
            assert "joined a running session" in client.status()["reason"]
            session = mock.controller.session
            wait_until(lambda: mock.controller.session > session, 30.0, what="the controller's next session")
            client.wait_for_status(state="ready", session="")
        after = [cycle for cycle in cycles.replies[killed + 5 :] if cycle.session == session]
    assert len({cycle.answered for cycle in after}) == 1, "no reply to a session that it joined"
    assert len({cycle.correction for cycle in after}) == 1, "HOLDON"
    assert max(cycle.missed for cycle in after) >= 2499


def test_sigterm_ends_the_program_cleanly(broker, topics, config_file):
    with client_of(broker, topics) as client, program(config_file, broker, topics) as (process, address):
        client.wait_for_status(state="no_controller")
        with controller_of(address) as controller:
            controller.cycle()
            assert controller.replies == [(0.0, 0.0)]
        process.send_signal(signal.SIGTERM)
        _, log = process.communicate(timeout=10.0)
        assert process.returncode == 0
        assert f"configuration {CONFIG.hash[:12]}" in log
        assert "measuring: RSI session began" in log
        client.wait_for_status(state="offline", reason="gateway stopped")


def test_ended_in_mid_motion_it_brakes_the_arm_before_it_goes(broker, topics):
    with cell(broker, topics, config=PATIENT) as (service, controller, client):
        assert client.arm(PATIENT)["ok"]
        stream(client, controller, (motion(k) for k in range(200)))
        count = len(controller.replies)
        service.stop()
        client.wait_for_status(state="offline", reason="gateway stopped")
        # the word is quicker than the controller's thread: what came last is known when the next telegram has no answer
        wait_until(lambda: controller.replies[-1] is None, what="a telegram without an answer")
        replies = [reply for reply in controller.replies[count:] if reply is not None]
    steps = [b[0] - a[0] for a, b in itertools.pairwise(replies)]
    budget = PATIENT.acceleration[0] * CYCLE**2 + 2 * math.radians(2e-6)
    assert abs(steps[0]) > 5 * budget
    assert steps[-1] == 0.0
    fastest = max(abs(b - a) for a, b in itertools.pairwise(steps[2:]))
    assert fastest <= budget + format_allowance(PATIENT.decimals) * CYCLE**2


@pytest.mark.parametrize("host", ["0.0.0.0", "192.0.2.1", "krc4.local"])
def test_on_a_network_it_does_not_start_without_knowing_its_controller(config_file, host):
    said = refused("--config", config_file, "--listen", f"{host}:0")
    assert "--controller" in said and host in said


def test_its_other_threads_hand_the_interpreter_over_within_a_quarter_of_a_cycle():
    code = "import sys; from construction_twin.gateway import command_line as program; "
    code += "program._run = lambda _: print(sys.getswitchinterval()); program.main(['--config', 'x'])"
    said = subprocess.run(command(code=code), capture_output=True, text=True, timeout=60.0, check=True).stdout
    assert float(said) <= CYCLE / 4


def test_a_log_that_nobody_reads_holds_up_no_reply(broker, topics, config_file):
    with program(config_file, broker, topics) as (process, address), client_of(broker, topics) as client:
        client.wait_for_status(state="no_controller")
        # every refused control is a log line; together they are far more than a pipe holds
        for _ in range(1500):
            client.paho.publish(topics.control, b"x" * 100, qos=1)
        client.wait_for_counter("refused_control", 1500, timeout=30.0)
        with controller_of(address) as controller:
            for _ in range(20):
                controller.cycle()
            assert controller.replies == [(0.0, 0.0)] * 20


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["--listen", "here"], ("--listen", "'here'", "HOST:PORT")),
        (["--listen", "127.0.0.1:70000"], ("--listen", "'127.0.0.1:70000'", "HOST:PORT")),
        (["--listen", "127.0.0.1:TAKEN"], ("cannot listen for RSI on UDP 127.0.0.1:TAKEN", "may hold the port")),
        (
            ["--controller", "no-such.invalid"],
            ("--controller", "'no-such.invalid'", "a name that this machine can look up"),
        ),
        (["--broker", "1883"], ("--broker", "'1883'", "HOST:PORT")),
        (["--commissioning", "yes"], ("--commissioning: invalid choice: 'yes'", "rsi_gateway --help")),
        (["--stop-file", "/dev/null/a"], ("--stop-file", "/dev/null/a")),
        (["--prefix", "a/b"], ("prefix", "'a/b'", "letters, digits")),
        (["--config", "/nowhere.json"], ("/nowhere.json", "No such file", "twin gateway")),
    ],
)
def test_what_cannot_work_is_one_sentence_and_exit_code_2(config_file, arguments, said):
    with bind("127.0.0.1", 0) as sock:
        taken = str(sock.getsockname()[1])
        found = refused("--config", config_file, *(argument.replace("TAKEN", taken) for argument in arguments))
    for words in said:
        assert words.replace("TAKEN", taken) in found


#: Only the standard library, paho and this package can be imported: what a cell PC has.
_CELL_PC = """
import runpy, sys
class CellPc:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top not in sys.stdlib_module_names and top not in ("paho", "construction_twin"):
            raise ModuleNotFoundError(f"{name} is not on the cell PC")
sys.meta_path.insert(0, CellPc())
sys.path[:0] = sys.argv[1:3]
module, sys.argv = sys.argv[3], sys.argv[3:]
runpy.run_module(module, run_name="__main__", alter_sys=True)
"""


def on_the_cell_pc(module, *arguments):
    site = str(Path(paho.__file__).parents[2])
    command = [sys.executable, "-S", "-E", "-c", _CELL_PC, str(ROOT / "src"), site, module, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60.0, cwd="/")


def test_the_gateway_needs_nothing_but_the_standard_library_and_paho(config_file):
    result = on_the_cell_pc("construction_twin.gateway", "--help")
    assert result.returncode == 0, result.stderr
    assert "--config" in result.stdout
    # beyond --help: it reads its configuration and gets as far as the socket
    with bind("127.0.0.1", 0) as sock:
        listen = f"127.0.0.1:{sock.getsockname()[1]}"
        result = on_the_cell_pc("construction_twin.gateway", "--config", config_file, "--listen", listen)
    assert result.returncode == 2
    assert "cannot listen for RSI" in result.stderr


def test_a_paho_that_was_not_tested_is_refused_in_one_sentence(config_file):
    code = (
        "import sys; from construction_twin.mqtt import fast_client; fast_client.TESTED_VERSIONS = ('1.2.3',); "
        "from construction_twin.gateway.command_line import main; sys.exit(main(sys.argv[1:]))"
    )
    said = refused("--config", config_file, "--listen", "127.0.0.1:0", code=code)
    assert "paho-mqtt: found " in said and "expected version 1.2.3: install that one" in said


def test_debian_s_paho_is_refused_in_one_sentence_that_names_the_version_that_is_pinned(tmp_path):
    package = tmp_path / "paho" / "mqtt"
    package.mkdir(parents=True)
    (tmp_path / "paho" / "__init__.py").touch()
    (package / "__init__.py").write_text('__version__ = "1.6.1"')
    (package / "client.py").touch()
    environment = os.environ | {"PYTHONPATH": f"{tmp_path}:{ROOT / 'src'}"}
    command = [sys.executable, "-m", "construction_twin.gateway", "--help"]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60.0, env=environment, cwd="/")
    assert result.returncode == 1 and result.stderr.count("\n") == 1
    assert f"needs paho-mqtt {TESTED_VERSIONS[-1]};" in result.stderr
