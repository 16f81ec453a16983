"""URDF text: expanded from a xacro, parsed, and the joints between two of its links."""

from __future__ import annotations

import contextlib
import io
import logging
import shlex
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree
from xml.parsers.expat import ExpatError

import xacro
import yaml
from urdf_parser_py.urdf import URDF, Joint
from urdf_parser_py.xml_reflection.core import ParseError
from xacro.substitution_args import ArgException

from construction_twin.core.errors import ConfigurationError, system_message
from construction_twin.robot.packages import Packages

_LOG = logging.getLogger(__name__)
#: The module of ROS 2 that xacro asks for the folder of a package.
_AMENT = "ament_index_python.packages"


def xacro_arguments(text: str) -> dict[str, str]:
    """Return a xacro file's arguments from words ``name=value`` or ``name:=value``, quoted as in a shell (``robot_xacro_args``)."""
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise ConfigurationError("robot_xacro_args", text, f"words name=value, divided by spaces ({error})") from error
    arguments: dict[str, str] = {}
    for word in words:
        name, separator, value = word.partition("=")
        name = name.removesuffix(":")
        if not (name and separator):
            raise ConfigurationError("robot_xacro_args", word, "words name=value, divided by spaces")
        arguments[name] = value
    return arguments


class _Arguments(dict[str, str]):
    """The arguments that xacro expands a file with; remembers which ones the file asked for."""

    def __init__(self, arguments_read: Mapping[str, str]):
        super().__init__(arguments_read)
        self.used: set[str] = set()

    def __contains__(self, name: object) -> bool:
        self.used.add(str(name))
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.used.add(name)
        return super().__getitem__(name)


def expand_xacro(path: str | Path, arguments: Mapping[str, str] | None = None) -> str:
    """Expand a xacro file to URDF text, indented. ``$(find pkg)`` is answered by rospack; meshes are relative to the file."""
    read_text(path)  # xacro's own message for a missing file does not say what was expected
    arguments_read = _Arguments(arguments or {})
    try:
        with _packages_by_rospack():
            document = xacro.process_file(str(path), mappings=arguments_read)
    except xacro.XacroException as error:
        raise _refusal(str(path), error) from error
    except ExpatError as error:
        raise ConfigurationError(str(path), _found(str(path), error), "well-formed XML") from error
    unknown = sorted(set(arguments or {}) - arguments_read.used)
    if unknown:
        known = sorted(arguments_read.used)
        expected = (
            f"one of the arguments that the file has: {known}"
            if known
            else "one of the arguments that the file has: none"
        )
        raise ConfigurationError(f"{path} argument", unknown[0], expected)
    for mesh in document.getElementsByTagName("mesh"):
        name = mesh.getAttribute("filename")
        if name and "://" not in name:
            # rviz has no file that this could be relative to
            mesh.setAttribute("filename", (Path(path).absolute().parent / name).as_uri())
    return document.toprettyxml(indent="  ")


@contextlib.contextmanager
def _packages_by_rospack() -> Iterator[None]:
    """Answer xacro's questions for ``$(find pkg)`` by rospack.

    xacro 2 imports `get_package_share_directory` from ROS 2's `ament_index_python`, which is not here: a module of that name stands
    in while a file is expanded. ROS 1's xacro asks rospack itself.
    """
    packages = Packages()
    stand_in = ModuleType(_AMENT, "Answers by rospack, see construction_twin.robot.urdf.")
    stand_in.__dict__["get_package_share_directory"] = lambda name: str(
        packages.folder(name, f"{xacro.filestack[-1]} $(find {name})")
    )
    before = sys.modules.get(_AMENT)
    sys.modules[_AMENT] = stand_in
    try:
        yield
    finally:
        if before is None:
            del sys.modules[_AMENT]
        else:
            sys.modules[_AMENT] = before


def _refusal(path: str, error: xacro.XacroException) -> ConfigurationError:
    """Return the error of a file that does not expand."""
    cause: BaseException | None = error
    while isinstance(cause, xacro.XacroException):
        cause = cause.exc
    if isinstance(cause, ConfigurationError):
        return cause
    if isinstance(cause, ArgException):
        where = f"{xacro.filestack[-1]} $(arg {cause})"
        return ConfigurationError(where, "no value", f"one in robot_xacro_args, e.g. {cause}=...")
    return ConfigurationError(path, _found(path, error), "a xacro file that expands")


def _found(path: str, error: Exception) -> str:
    """Return what is wrong, and where, if that is in a file that the one at `path` includes."""
    reading = str(xacro.filestack[-1])
    return str(error) if reading == path else f"{error} (in {reading})"


def parse_urdf(urdf: str) -> URDF:
    """Parse URDF text with urdfdom's Python parser. What it prints about unknown tags goes to the debug log."""
    remarks = io.StringIO()
    try:
        # bytes, because the XML parser refuses an encoding declaration in a str
        with contextlib.redirect_stderr(remarks):
            model = URDF.from_xml_string(urdf.encode())
    except (ParseError, ElementTree.ParseError, AssertionError, KeyError, ValueError) as error:
        if isinstance(error, ParseError):
            _check_limits(urdf)
        raise ConfigurationError("URDF", " ".join(str(error).split()), "a URDF") from error
    for remark in remarks.getvalue().splitlines():
        _LOG.debug("URDF: %s", remark)
    return model


def _check_limits(urdf: str) -> None:
    """Refuse joints whose `<limit>` lacks effort or velocity."""
    lacking = []
    for joint in ElementTree.fromstring(urdf.encode()).iterfind("joint"):
        for limit in joint.iterfind("limit"):
            absent = [key for key in ("effort", "velocity") if key not in limit.attrib]
            lacking += [f"{joint.get('name')} without {' and '.join(absent)}"] if absent else []
    if lacking:
        expected = (
            'effort="..." [N m, N], 0 where it is unknown, and velocity="..." [rad/s, m/s], the full speed that the maker '
            "states, in the <limit> of each"
        )
        raise ConfigurationError("URDF joints", ", ".join(lacking), expected)


def chain_joints(model: URDF, base_link: str, tip_link: str) -> list[Joint]:
    """Return the joints from `base_link` to `tip_link`, fixed ones included."""
    for key, link in (("robot/base_link", base_link), ("robot/tip_link", tip_link)):
        if link not in model.link_map:
            raise ConfigurationError(key, link, f"one of the URDF's links {sorted(model.link_map)}")
    joints: list[Joint] = []
    link = tip_link
    while link != base_link:
        if link not in model.parent_map or len(joints) == len(model.joints):
            raise ConfigurationError("robot/tip_link", tip_link, f"a descendant of {base_link}")
        name, link = model.parent_map[link]
        joints.append(model.joint_map[name])
    return joints[::-1]


def read_text(path: str | Path) -> str:
    """Return the contents of a text file in UTF-8."""
    try:
        return Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(str(path), system_message(error), "a readable text file") from error


def read_yaml(path: str | Path, of_what: str = "") -> Any:
    """Return what a YAML file holds; `of_what`: what it describes, for messages."""
    try:
        return yaml.safe_load(read_text(path))
    except yaml.YAMLError as error:
        raise ConfigurationError(str(path), " ".join(str(error).split()), f"a YAML file{of_what}") from error
