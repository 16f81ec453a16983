"""A site with a console for tests: real mosquitto with accounts, the console's program, files of the robot, without ROS."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

from processes import ROOT, BrokerProcess, free_port, listens, wait_until
from scripted_robot import VIEW, XACRO, ScriptedRobot
from site_broker import ROBOTS, SiteBroker

from construction_twin.mqtt.client import Broker
from construction_twin.robot.urdf import expand_xacro

#: The page as `setup/setup.sh console` builds it.
PAGE = ROOT / ".ws/console/page"
_PACKAGE = "package://construction_twin/"
#: Person with one account for every robot.
PERSON = "pat"
#: Who may do what in the tests.
PEOPLE = (
    *("ada:operate,approve@one", "bob:operate,approve@one", "vic:look@one", "pia:operate@one"),
    *("dora:operate,approve,reset", f"{PERSON}:operate,approve"),
)


def write_robot_files(private: Path, robots: tuple[str, ...] = ROBOTS) -> None:
    """Write the URDF of each robot, and its meshes by digest, as the console serves them."""
    urdf = ElementTree.fromstring(expand_xacro(XACRO).encode())
    meshes = private / "mesh"
    meshes.mkdir(parents=True)
    for link in urdf.iter("link"):
        for collision in link.findall("collision"):
            link.remove(collision)
    for mesh in urdf.iter("mesh"):
        source = ROOT / mesh.get("filename", "").removeprefix(_PACKAGE)
        name = hashlib.sha256(source.read_bytes()).hexdigest() + source.suffix
        shutil.copy(source, meshes / name)
        mesh.set("filename", f"../mesh/{name}")
    for robot in robots:
        (private / robot).mkdir()
        (private / robot / "robot.urdf").write_bytes(ElementTree.tostring(urdf))


def run_console(log: Path, page: Path, listen: str, port: int, *more: str | Path) -> subprocess.Popen:
    """Start the console's program and return it once it listens; what it says goes to `log`."""
    command = [sys.executable, ROOT / "nodes/console", "--page", page, "--listen", listen, "--port", str(port), *more]
    with open(log, "ab") as file:
        process = subprocess.Popen(command, stdout=file, stderr=file)
    wait_until(lambda: listens(port, listen), 30.0, "the console listening")
    return process


class OpenSite:
    """One machine as bringup has it: a broker without accounts, the console over HTTP, both on loopback.

    Attributes:
        url: Of the page.
    """

    def __init__(self, folder: Path):
        self._folder = folder
        self._port = free_port()
        self._broker = BrokerProcess()
        self._console: subprocess.Popen | None = None
        write_robot_files(folder / "private")
        self.url = f"http://127.0.0.1:{self._port}/"

    def __enter__(self) -> OpenSite:
        self._broker.start()
        more = ("--private", self._folder / "private", "--broker-port", str(self._broker.port))
        self._console = run_console(self._folder / "console.log", PAGE, "127.0.0.1", self._port, *more)
        return self

    def __exit__(self, *_) -> None:
        if self._console is not None:
            self._console.kill()
            self._console.wait(5.0)
        self._broker.kill()

    def robot(self, name: str, period: float = VIEW) -> ScriptedRobot:
        """Return a robot of this site, not started."""
        return ScriptedRobot(Broker("127.0.0.1", self._broker.port), name, period=period)


class ConsoleSite:
    """A site in a folder: broker, console, robots.

    Args:
        listen, host: Address on which the console listens, and the name by which a browser reaches it.
        hosts: Further names in the certificates.

    Attributes:
        url: Of the page.
        log: What the console says.
    """

    def __init__(
        self,
        folder: Path,
        page: Path = PAGE,
        listen: str = "127.0.0.1",
        host: str = "localhost",
        hosts: tuple[str, ...] = (),
    ):
        self.folder = folder
        self.port = free_port()
        self.private = folder / "private"
        write_robot_files(self.private)
        names = ("localhost", "127.0.0.1", *hosts)
        self.site = SiteBroker(
            folder / "site",
            hosts=names,
            plc=False,
            consoles=names,
            persons=PEOPLE,
        )
        self.url = f"https://{host}:{self.port}/"
        self.log = folder / "console.log"
        self._page, self._listen = page, listen
        self._process: subprocess.Popen | None = None

    def start(self) -> ConsoleSite:
        self.site.start()
        self.start_console()
        return self

    def start_console(self) -> None:
        files = self.site.folder / "console"
        self._process = run_console(
            self.log, self._page, self._listen, self.port, "--private", self.private,
            "--rights", files / "rights.json", "--certificate", files / "console.crt", "--key", files / "console.key",
            "--broker-host", "localhost", "--broker-port", str(self.site.site.port), "--broker-ca", self.site.folder / "ca/ca.crt",
        )  # fmt: skip

    def stop_console(self) -> None:
        """End it as a power cut would."""
        if self._process is not None:
            self._process.kill()
            self._process.wait(5.0)
            self._process = None

    def stop(self) -> None:
        self.stop_console()
        self.site.stop()

    def robot(self, name: str = ROBOTS[0], **more) -> ScriptedRobot:
        """Return a robot of this site, not started."""
        return ScriptedRobot(self.site.broker(self.site.account(f"{name}-bridge")), name, **more)

    def password(self, account: str) -> str:
        """Return what a person types."""
        return (self.site.folder / "accounts" / account / "password").read_text().strip()
