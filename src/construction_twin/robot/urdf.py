"""URDF text: expanded from a xacro, parsed, and the joints between two of its links."""

from __future__ import annotations

import contextlib
import io
import logging
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers.expat import ExpatError

import xacro
from urdf_parser_py.urdf import URDF, Joint
from urdf_parser_py.xml_reflection.core import ParseError

from construction_twin.core.errors import ConfigurationError

_LOG = logging.getLogger(__name__)


def expand_xacro(path: str | Path, arguments: Mapping[str, str] | None = None) -> str:
    """Expand a xacro file to URDF text.

    Parameters
    ----------
    path : str or Path
    arguments : Mapping of str to str, optional
        Values for the file's ``xacro:arg`` elements.

    Returns
    -------
    urdf : str
        Indented XML.

    Raises
    ------
    ConfigurationError
        If the file cannot be read or expanded.
    """
    read_text(path)  # xacro's own message for a missing file does not say what was expected
    try:
        return xacro.process_file(str(path), mappings=dict(arguments or {})).toprettyxml(indent="  ")
    except xacro.XacroException as error:
        raise ConfigurationError(str(path), str(error), "a xacro file that expands") from error
    except ExpatError as error:
        raise ConfigurationError(str(path), str(error), "well-formed XML") from error


def parse_urdf(urdf: str) -> URDF:
    """Parse URDF text with urdfdom's Python parser. What it prints about unknown tags goes to the debug log.

    Raises
    ------
    ConfigurationError
        If the text is not a URDF.
    """
    remarks = io.StringIO()
    try:
        # bytes, because the XML parser refuses an encoding declaration in a str
        with contextlib.redirect_stderr(remarks):
            model = URDF.from_xml_string(urdf.encode())
    except (ParseError, ElementTree.ParseError, AssertionError, KeyError, ValueError) as error:
        raise ConfigurationError("robot_description", str(error), "a URDF") from error
    for remark in remarks.getvalue().splitlines():
        _LOG.debug("robot_description: %s", remark)
    return model


def chain_joints(model: URDF, base_link: str, tip_link: str) -> list[Joint]:
    """Return the joints from `base_link` to `tip_link`, fixed ones included.

    Raises
    ------
    ConfigurationError
        If a link is missing or `tip_link` does not descend from `base_link`.
    """
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
    """Return the contents of a text file in UTF-8.

    Raises
    ------
    ConfigurationError
        If it cannot be read.
    """
    try:
        return Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(str(path), str(error), "a readable text file") from error
