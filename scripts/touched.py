"""Which tests a change touches: `python scripts/touched.py [COMMIT]` lists them; `make test ARGS=changed` runs them.

A graph of files, made anew each time. A Python file leads to what it imports, anywhere in it, and to the files that its texts name:
a file by its name (`kr120.yaml`), its path (`ROOT / "docs" / "planning.md"`) or as a module (`-m construction_twin.gateway`), and
all files of a folder by the folder's path (`ROOT / "docs"`). A test is touched when something that it leads to has changed, over
any number of files.

That is more than a test reads, and rarely less: what a program finds by itself at run time is seen only where a text names it. The
tests of test/integration bring up the whole system, so that every change of the package touches each of them: only those are listed
here whose own files have changed.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parent.parent
#: A change of one of these touches every test: how they are run, and with which packages.
EVERYTHING = re.compile(r"pyproject\.toml|setup/|test/unit/conftest\.py|CMakeLists\.txt|package\.xml")
#: Where a module is found that is imported without a package; `pythonpath` in pyproject.toml.
FOLDERS = ("test/support", "test/integration", "test/unit", "test/fuzz", "scripts", "tools", "benchmarks", "examples")
PACKAGE = "src/construction_twin/"
_WORD = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_./-]*")
#: Texts that are longer are documents or data, not names.
_LONGEST = 2000


def git(*words: str) -> list[str]:
    """Return the lines that git prints in the repository."""
    run = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
    return run.stdout.splitlines()


def changed_files(since: str = "") -> tuple[str, list[str]]:
    """Return a commit, and the paths that differ from it in the working tree, deleted and new ones too.

    Args:
        since: The commit; by default where this branch left the remote's main branch, or the commit before the last one where
            nothing differs from that.
    """

    def differing(commit: str) -> list[str]:
        return git("diff", "--name-only", "--no-renames", commit, "--")

    untracked = git("ls-files", "--others", "--exclude-standard")
    if since:
        return since, [*differing(since), *untracked]
    try:
        (base,) = git("merge-base", "HEAD", "origin/main")
    except subprocess.CalledProcessError:
        base = "HEAD"
    found = [*differing(base), *untracked]
    return (base, found) if found else ("HEAD~1", differing("HEAD~1"))


class Graph:
    """What each file leads to.

    Args:
        paths: Of the repository, as git names them; what was deleted may be among them.
    """

    def __init__(self, paths: Iterable[str], root: Path = ROOT):
        self.paths = sorted(set(paths))
        self.root = root
        self._modules: dict[str, str] = {}
        self._by_word: defaultdict[str, set[str]] = defaultdict(set)
        self._in_folder: defaultdict[str, set[str]] = defaultdict(set)
        for path in self.paths:
            self._name(path)
        self._leads: dict[str, tuple[set[str], set[str]]] = {}

    def leads_to(self, path: str) -> tuple[set[str], set[str]]:
        """Return what a file imports or runs, and what it only names: of the latter it is touched, but not of what that imports."""
        if path not in self._leads:
            runs: set[str] = set()
            names: set[str] = set()
            for other, is_run in self._read(path):
                (runs if is_run else names).add(other)
            self._leads[path] = runs, names
        return self._leads[path]

    def reached(self, start: str) -> set[str]:
        """Return what a file leads to over any number of files, itself included."""
        found, named, waiting = {start}, set(), [start]
        while waiting:
            runs, names = self.leads_to(waiting.pop())
            named |= names
            new = runs - found
            found |= new
            waiting += new
        return found | named

    def _name(self, path: str) -> None:
        """Note by which words of a text, and by which import, a file is meant."""
        if path.startswith(PACKAGE) and path.endswith(".py"):
            self._modules[path.removeprefix("src/").removesuffix(".py").replace("/", ".").removesuffix(".__init__")] = (
                path
            )
        elif path.endswith(".py"):
            if path.startswith(FOLDERS):
                self._modules.setdefault(Path(path).stem, path)
        elif "." in Path(path).name:
            self._by_word[Path(path).name].add(path)
        self._by_word[path].add(path)
        for folder in Path(path).parents:
            self._in_folder[str(folder)].add(path)

    def _read(self, path: str) -> Iterator[tuple[str, bool]]:
        if not path.endswith(".py") or not (self.root / path).is_file():
            return
        for parent in Path(path).parents:
            beside = f"{parent}/conftest.py"
            if path.startswith("test/") and beside in self._by_word:
                yield beside, True
        tree = ast.parse((self.root / path).read_text())
        told = {id(node.body[0].value) for node in ast.walk(tree) if _has_docstring(node)}
        # what is imported for annotations alone, or for a folder's list of names, is not loaded
        told |= {
            id(inside)
            for node in ast.walk(tree)
            if _is_for_types(node)
            for each in node.body
            for inside in ast.walk(each)
        }
        # from the outside: of `ROOT / "docs" / "planning.md"` the whole is read first, and its parts not again
        for node in ast.walk(tree):
            if id(node) in told:
                continue
            if isinstance(node, ast.Import):
                yield from ((each, True) for alias in node.names for each in self._module(alias.name))
            elif isinstance(node, ast.ImportFrom) and node.module:
                yield from ((each, True) for each in self._module(node.module, [alias.name for alias in node.names]))
            elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div):
                parts = list(_joined(node))
                told |= {id(part) for part in parts}
                joined = "/".join(part.value for part in parts if isinstance(part, ast.Constant)).rstrip("/")
                yield from ((each, False) for each in self._in_folder.get(joined, ()))
                yield from self._words(joined)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield from self._words(node.value)

    def _module(self, name: str, names: Iterable[str] = ()) -> Iterator[str]:
        """Return the files that an import of a module, or of names from it, leads to."""
        if name.endswith((".msg", ".srv")):
            # made from the file of that name
            kind = name.rpartition(".")[2]
            yield from (f"{kind}/{each}.{kind}" for each in names if f"{kind}/{each}.{kind}" in self._by_word)
        for each in names:
            if f"{name}.{each}" in self._modules:
                yield self._modules[f"{name}.{each}"]
        parts = name.split(".")
        for length in range(1, len(parts) + 1):
            # the folders above are imported, too
            if (module := ".".join(parts[:length])) in self._modules:
                yield self._modules[module]
        own = self._modules.get(name, "")
        if own.endswith("/__init__.py") and own.count("/") > 2:
            # a folder may hand out names of its modules when they are asked for
            inside = [each for each in names if f"{name}.{each}" not in self._modules]
            if inside or not names:
                yield from self._in_folder[str(Path(own).parent)]

    def _words(self, text: str) -> Iterator[tuple[str, bool]]:
        if len(text) > _LONGEST:
            return
        for word in _WORD.findall(text):
            word = word.rstrip("./")
            # a test that is named is a text to whoever names it, any other program is run
            yield from ((each, not is_test(each)) for each in self._by_word.get(word, ()))
            # `work` alone is a word of many meanings
            if "/" in word:
                yield from ((each, False) for each in self._in_folder.get(word, ()))
                yield from ((each, True) for each in self._by_word.get(word.rpartition("/")[2], ()))
            if word in self._modules and "." in word:
                run = (self._modules.get(name) for name in (word, f"{word}.__main__"))
                yield from ((each, True) for each in run if each)


def imported(file: Path) -> set[str]:
    """Return the names of the modules that a Python file imports, anywhere in it."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
    return found


def _is_for_types(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test).rpartition(".")[2] == "TYPE_CHECKING"


def _joined(node: ast.expr) -> Iterator[ast.expr]:
    """Return the nodes of a path that is joined with `/`, and its texts, from the left."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div):
        yield node
        yield from _joined(node.left)
        yield from _joined(node.right)
    elif isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node


def _has_docstring(node: ast.AST) -> bool:
    holds = isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef))
    return (
        holds
        and bool(node.body)
        and isinstance(node.body[0], ast.Expr)
        and isinstance(node.body[0].value, ast.Constant)
    )


def is_test(path: str) -> bool:
    """Return whether a path is a file of tests that pytest runs."""
    return (
        path.startswith(("test/unit/", "test/browser/"))
        and Path(path).name.startswith("test_")
        and path.endswith(".py")
    )


def touched(changed: Iterable[str], graph: Graph) -> list[str]:
    """Return the files of unit tests, tests of the page and rostests that a change touches, sorted."""
    changed = set(changed)
    tests = [path for path in graph.paths if is_test(path) and (graph.root / path).is_file()]
    everything = any(EVERYTHING.match(path) for path in changed)
    found = {path for path in tests if path.startswith("test/unit/") and (everything or changed & graph.reached(path))}
    page = any(path.startswith("web/") for path in changed)
    found |= {path for path in tests if path.startswith("test/browser/") and (page or changed & graph.reached(path))}
    return sorted(found | set(_rostests(changed, graph)))


def started_by(rostest: str) -> list[str]:
    """Return the files of tests that a rostest runs: its programs, and what `together.py` is given."""
    found: list[str] = []
    for test in ElementTree.fromstring(rostest).iter("test"):
        found.append(test.get("type", ""))
        if found[-1] == "together.py":
            found += [f"{name}.py" for name in test.get("args", "").split()]
    return found


def _rostests(changed: set[str], graph: Graph) -> Iterator[str]:
    for path in graph.paths:
        if path.startswith("test/integration/") and path.endswith(".test") and (graph.root / path).is_file():
            scripts = started_by((graph.root / path).read_text())
            own = {path} | {each for name in scripts for each in graph.reached(f"test/integration/{name}")}
            if {each for each in own if each.startswith(("test/integration/", "test/support/"))} & changed:
                yield path


def touched_by_a_change(since: str = "") -> list[str]:
    """Return the tests that the present change touches; say what has changed."""
    commit, changed = changed_files(since)
    known = [*git("ls-files"), *git("ls-files", "--others", "--exclude-standard"), *changed]
    found = touched(changed, Graph(known))
    print(f"changed since {commit[:12]}: {len(changed)} files; {len(found)} files of tests are touched", flush=True)
    return found


if __name__ == "__main__":
    print("\n".join(touched_by_a_change(*sys.argv[1:2])))
