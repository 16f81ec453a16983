"""What roslaunch was called with, and the arguments that its launch files know. Standard library only.

roslaunch takes every ``name:=value``: a misspelt name is stored and never read; an empty value and one with a second ``:=`` are
dropped, so that the default counts. All are told here, with what was probably meant.
"""

from __future__ import annotations

import difflib
import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from construction_twin.core.sentences import Sentence

#: Options of roslaunch that take a value, as a word of their own or after ``=``.
_WITH_VALUE = (
    "--args", "--find-node", "-c", "--child", "-u", "--server_uri", "--run_id", "-p", "--port", "--pid", "-w", "--numworkers",
    "-t", "--timeout", "--master-logger-level", "--sigint-timeout", "--sigterm-timeout",
)  # fmt: skip
#: Options with which roslaunch only prints what is in the files.
_PRINTS = {"--files", "--args", "--nodes", "--find-node", "--dump-params", "--ros-args"}

#: Arguments that can be given as ``none``: no file.
NONE = {"scene", "scene_1", "scene_2"}


@dataclass(frozen=True)
class RoslaunchCall:
    """A command line of roslaunch.

    Attributes:
        files: A package and the name of a file in it, or paths.
        given: Arguments; of several for one name the last.
        options: With their values; empty for those without one.
    """

    files: tuple[str, ...]
    given: Mapping[str, str]
    options: Mapping[str, str]

    @property
    def starts(self) -> bool:
        """Whether it starts nodes, and does not only print what the files hold."""
        return not _PRINTS & set(self.options)

    @property
    def port(self) -> str:
        """The master's port; empty: that of ROS_MASTER_URI."""
        return self.options.get("-p", self.options.get("--port", ""))


def roslaunch_call(command: Sequence[str]) -> RoslaunchCall | None:
    """Return what roslaunch was called with; None for the command line of another program.

    Args:
        command: The whole command line of a process, with or without the interpreter before the program.
    """
    start = next((i for i, word in enumerate(command[:2]) if Path(word).name == "roslaunch"), None)
    if start is None:
        return None
    files, given, options = [], {}, {}
    words = iter(command[start + 1 :])
    for word in words:
        name, equals, value = word.partition("=")
        if ":=" in word:
            # ROS's own, such as __ns, and parameters of nodes begin with _
            if not word.startswith("_"):
                name, value = word.split(":=", 1)
                given[name.strip()] = value.strip()
        elif word.startswith("--"):
            options[name] = value if equals or name not in _WITH_VALUE else next(words, "")
        elif word.startswith("-") and len(word) > 1:
            short = word[:2]
            options[short] = word[2:] or (next(words, "") if short in _WITH_VALUE else "")
        else:
            files.append(word)
    return RoslaunchCall(tuple(files), given, options)


def known_arguments(path: str | Path, find_package: Callable[[str], str | None]) -> dict[str, str] | None:
    """Return the arguments that a call of roslaunch can set in a launch file, and in those that it passes all of them to.

    Args:
        find_package: Returns the folder of a ROS package, None if there is none of this name.

    Returns:
        The default of each, as the file writes it; empty when it has none. None if an included file cannot be told in advance.
    """
    try:
        root = ElementTree.parse(path).getroot()
    except (OSError, ElementTree.ParseError):
        return None  # roslaunch says so itself
    known: dict[str, str] = {}
    for element in _elements(root):
        if element.tag == "arg" and "value" not in element.attrib:
            known.setdefault(element.get("name", ""), element.get("default", ""))
        elif element.tag == "include" and element.get("pass_all_args", "").lower() == "true":
            file = _resolved(element.get("file", ""), Path(path).parent, find_package)
            included = known_arguments(file, find_package) if file else None
            if included is None:
                return None
            fixed = {arg.get("name") for arg in element.findall("arg")}
            known = {name: default for name, default in included.items() if name not in fixed} | known
    return known


def argument_problem(given: Mapping[str, str], known: Mapping[str, str], file: str) -> str:
    """Return a sentence about the first argument that would have no effect; empty when there is none.

    Args:
        given, known: Of the call, and of its launch file.
        file: Name of the launch file.
    """
    for name, value in given.items():
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            if near:
                return Sentence("preflight.argument.near", name=name, value=value, file=file, near=near[0])
            return Sentence("preflight.argument.unknown", name=name, value=value, file=file)
        if ":=" in value:
            meant = shlex.quote(value.replace(":=", "="))
            return Sentence("preflight.argument.second", name=name, value=value, meant=meant)
        if not value and known[name]:
            key = "preflight.argument.empty_none" if name in NONE else "preflight.argument.empty"
            return Sentence(key, name=name)
    return ""


def _elements(parent: ElementTree.Element):
    """Yield what a launch file holds, also in groups."""
    for element in parent:
        if element.tag == "group":
            yield from _elements(element)
        else:
            yield element


def _resolved(text: str, folder: Path, find_package: Callable[[str], str | None]) -> str | None:
    """Return the path that an include names, None if that depends on more than packages."""
    found = re.fullmatch(r"\$\(find ([\w-]+)\)(/[^$]*)", text.strip())
    if found:
        package = find_package(found[1])
        return package and package + found[2]
    found = re.fullmatch(r"\$\(dirname\)(/[^$]*)", text.strip())
    if found:
        return f"{folder}{found[1]}"
    return text.strip() if text.strip() and "$" not in text else None
