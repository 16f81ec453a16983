"""Counts what the tree weighs and prints it beside its limits: `python3 scripts/size.py [--check | --lower]`.

Standard library only. `scripts/size.toml` holds a limit and a budget per figure. `--check` (part of `make lint`) ends with 1 where
a figure is above its limit; `--lower` writes the figures of this tree as the new limits where they are smaller. A limit rises only
by hand, with a sentence in the commit that says for whom. A line of the page longer than 120 columns counts as several, because
nothing formats its sources.
"""

from __future__ import annotations

import argparse
import ast
import math
import re
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import tomllib

ROOT = Path(__file__).resolve().parent.parent
LIMITS = ROOT / "scripts" / "size.toml"
COLUMNS = 120
PACKAGE = Path("src/construction_twin")
#: A folder that becomes an extension is counted apart already where it is now.
EXTENSIONS = ("work", "physics", "console", "planners")
#: The rows of the floor plan that are core: name, folders of the package.
CORE = {
    "core": ("core",),
    "robot, kinematics": ("robot", "kinematics"),
    "scene, planning": ("scene", "planning"),
    "monitor, servo": ("monitor", "servo"),
    "execution, review": ("execution", "review"),
    "mqtt, link, broker": ("mqtt", "link", "broker"),
    "controller, rsi, gateway": ("controller", "rsi", "gateway"),
    "twin, mock": ("twin", "mock"),
    "evaluation, scenario": ("evaluation", "scenario"),
    "ros, views": ("ros", "views"),
}


def files(folder: str, *endings: str) -> list[Path]:
    """Return the files below a folder of the tree with one of the endings, without what was made or installed."""
    return [
        path
        for path in sorted((ROOT / folder).rglob("*"))
        if path.is_file()
        and path.suffix in endings
        and not {"node_modules", "__pycache__", "schemas.js"} & set(path.parts)
    ]


def lines(paths: Iterable[Path]) -> int:
    """Count the lines of text files."""
    return sum(path.read_text().count("\n") for path in paths)


def lines_as_formatted(paths: Iterable[Path]) -> int:
    """Count the lines of text files as if none were longer than `COLUMNS`."""
    return sum(math.ceil(max(len(line), 1) / COLUMNS) for path in paths for line in path.read_text().splitlines())


@cache
def nodes_of(path: Path) -> list[ast.AST]:
    """Return every node of the syntax tree of a Python file."""
    return list(ast.walk(ast.parse(path.read_text())))


def statements(paths: Iterable[Path]) -> int:
    """Count the statements of Python files, docstrings left out."""
    return sum(
        isinstance(node, ast.stmt) and not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant))
        for path in paths
        for node in nodes_of(path)
    )


def first_texts(calls: str, source: list[Path]) -> set[str]:
    """Return the distinct first arguments of the calls whose name matches, as written."""
    found = (node for path in source for node in nodes_of(path) if isinstance(node, ast.Call) and node.args)
    return {ast.unparse(node.args[0]) for node in found if re.fullmatch(calls, ast.unparse(node.func))}


def settings(source: list[Path]) -> int:
    """Count the fields of the settings of nodes and commands: pydantic's models whose name ends with Settings."""
    classes = [node for path in source for node in nodes_of(path) if isinstance(node, ast.ClassDef)]
    models = [
        kind for kind in classes if re.search("BaseModel|StrictModel|Settings", " ".join(map(ast.unparse, kind.bases)))
    ]
    return sum(
        isinstance(field, ast.AnnAssign) for kind in models if kind.name.endswith("Settings") for field in kind.body
    )


def launch_arguments(paths: Iterable[Path]) -> set[str]:
    """Return the names of the arguments that a user may give: those without a fixed value."""
    return {
        arg.get("name", "")
        for path in paths
        for arg in ElementTree.parse(path).iter("arg")
        if arg.get("doc") and "value" not in arg.attrib
    }


def substituted(text: str, given: dict[str, str]) -> str:
    """Return an attribute of a launch file with its arguments filled in, as roslaunch does."""
    if text.startswith("$(eval "):
        functions = {
            "arg": lambda name: literal(given[name]),
            "find": lambda name: str(ROOT),
            "optenv": lambda name, other="": other,
        }
        names = {name: literal(value) for name, value in given.items()}
        return str(eval(text[len("$(eval ") : -1], {"__builtins__": {"str": str, "int": int}}, names | functions))
    text = re.sub(r"\$\(arg (\w+)\)", lambda match: given[match[1]], text)
    return re.sub(r"\$\((find|dirname|optenv|env|anon)[^)]*\)", str(ROOT), text)


def literal(text: str) -> object:
    """Return the value that roslaunch makes of an argument's text."""
    return int(text) if text.isdecimal() else {"true": True, "false": False}.get(text.lower(), text)


def nodes_started(path: Path, given: dict[str, str]) -> int:
    """Count the nodes that a launch file of this package starts with its arguments' defaults."""

    def count(element: ElementTree.Element, values: dict[str, str]) -> int:
        total = 0
        for child in element:
            if "if" in child.attrib and literal(substituted(child.attrib["if"], values)) is not True:
                continue
            if "unless" in child.attrib and literal(substituted(child.attrib["unless"], values)) is True:
                continue
            if child.tag == "arg":
                text = child.get("value", values.get(child.attrib["name"], child.get("default")))
                values[child.attrib["name"]] = text if text is None else substituted(text, values)
            elif child.tag == "include":
                handed_on = dict(values) if child.get("pass_all_args") == "true" else {}
                handed_on |= {
                    arg.attrib["name"]: substituted(arg.get("value", ""), values) for arg in child.findall("arg")
                }
                total += nodes_started(ROOT / "launch" / Path(child.attrib["file"]).name, handed_on)
            elif child.tag == "group":
                total += count(child, dict(values))
            elif child.tag == "node":
                total += 1
        return total

    return count(ElementTree.parse(path).getroot(), dict(given))


def measured() -> dict[str, int]:
    """Return every figure of this tree by its name."""
    source = files("src", ".py")
    nodes = [path for path in (ROOT / "nodes").iterdir() if path.is_file()]
    tests, tools = (
        files("test", ".py"),
        [*files("scripts", ".py", ".sh"), *files("tools", ".py"), *files("benchmarks", ".py")],
    )
    page, page_tests = files("web/src", ".js", ".css"), files("web/test", ".js", ".mjs")
    docs = [*files("docs", ".md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
    extension = {
        name: [*files(str(PACKAGE / name), ".py"), *files(str(PACKAGE / "extensions" / name), ".py")]
        for name in EXTENSIONS
    }
    core = sorted(set(source) - {path for paths in extension.values() for path in paths})
    bringup = launch_arguments([ROOT / "launch" / "bringup.launch"])
    result = {
        "src: lines": lines(source),
        "src: statements": statements(source),
        "src: files": len(source),
        "core: lines": lines(core),
        "core: statements": statements(core),
    }
    for name, folders in CORE.items():
        result[f"core, {name}: lines"] = lines(
            path for folder in folders for path in files(str(PACKAGE / folder), ".py")
        )
    for name, paths in extension.items():
        result[f"extension {name}: lines"] = lines(paths)
        result[f"extension {name}: statements"] = statements(paths)
    return result | {
        "tests: lines": lines(tests),
        "tests: statements": statements(tests),
        "tests: lines of support": lines(files("test/support", ".py")),
        "page: lines of JavaScript and CSS": lines_as_formatted(page),
        "page: lines of its tests": lines_as_formatted(page_tests),
        "translations: lines": lines([*files("src", ".json"), *files("web/locale", ".po")]),
        "docs: lines": lines(docs),
        "docs: words": sum(len(path.read_text().split()) for path in docs),
        "scripts, tools, benchmarks: lines": lines(tools),
        "mutations": (ROOT / "scripts" / "mutations.toml").read_text().count("[[mutation]]"),
        "launch arguments": len(launch_arguments(files("launch", ".launch"))),
        "launch arguments of bringup": len(bringup),
        "parameters": settings(source),
        "topics": len(first_texts(r"(\w+\.)?\w*Publication", source)),
        "services": len(first_texts(r"(\w+\.)?Served", source)),
        "programs": len(nodes),
        "processes of a bringup": nodes_started(ROOT / "launch" / "bringup.launch", {}),
        "formatter: line length": tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["ruff"]["line-length"],
        "formatter: switched off": sum(
            path.read_text().count("fmt: off") + path.read_text().count("fmt: skip") for path in [*source, *tests]
        ),
    }


def main() -> int:
    """Print the table; return 1 with --check where a figure is above its limit."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    choice = parser.add_mutually_exclusive_group()
    choice.add_argument(
        "--check", action="store_true", help="say which figures are above their limits, and nothing else"
    )
    choice.add_argument("--lower", action="store_true", help="make today's figures the limits where they are smaller")
    arguments = parser.parse_args()
    figures, table = measured(), tomllib.loads(LIMITS.read_text())
    above = [name for name, figure in figures.items() if figure > table.get(name, {}).get("limit", -1)]
    if not arguments.check:
        print(f"{'':40}{'now':>9}{'limit':>9}{'budget':>9}")
        for name, figure in figures.items():
            row = table.get(name, {})
            print(
                f"{name:40}{figure:9,}{row.get('limit', 0):9,}{row.get('budget', ''):>9}{' above' if name in above else ''}"
            )
    if arguments.lower:
        LIMITS.write_text(lowered(LIMITS.read_text(), figures))
        return 0
    for name in above:
        limit = table.get(name, {}).get("limit")
        print(f"size: {name} is {figures[name]}, above its limit {limit} in scripts/size.toml; make it smaller")
    return 1 if above and arguments.check else 0


def lowered(text: str, figures: dict[str, int]) -> str:
    """Return size.toml with each limit that is above its figure replaced by the figure."""

    def row(match: re.Match) -> str:
        return f"{match[1]}{min(int(match[3]), figures.get(match[2], int(match[3])))}"

    return re.sub(r'^("(.*)" = \{ limit = )(\d+)', row, text, flags=re.MULTILINE)


if __name__ == "__main__":
    sys.exit(main())
