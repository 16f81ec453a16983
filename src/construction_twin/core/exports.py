"""The names that a folder's `__init__` offers, each loaded when it is first asked for (PEP 562).

An `__init__` lists them once, as imports below ``if TYPE_CHECKING``. Type checkers and editors read these lines, and so does
`lazy_exports`, so that importing a folder loads none of its modules and no library that one of them needs. Standard library only.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable
from importlib import import_module


def lazy_exports(package: str) -> tuple[Callable[[str], object], Callable[[], list[str]], list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` of a folder.

    Args:
        package: The folder's ``__name__``. A name that it offers raises ModuleNotFoundError, which says where to look, if a library
            that the name's module needs is not installed.
    """
    modules = _listed(package)

    def get(name: str) -> object:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        try:
            value = getattr(import_module(modules[name]), name)
        except ModuleNotFoundError as error:
            if (error.name or "").partition(".")[0] == package.partition(".")[0]:
                raise
            told = f"{package}.{name} needs {error.name}, which is not installed; docs/library.md says what brings it"
            raise ModuleNotFoundError(told, name=error.name) from error
        # the next time it is there
        setattr(sys.modules[package], name, value)
        return value

    def names() -> list[str]:
        return sorted({*vars(sys.modules[package]), *modules})

    return get, names, sorted(modules)


def _listed(package: str) -> dict[str, str]:
    """Return the module of each name that is imported below ``if TYPE_CHECKING``."""
    spec = sys.modules[package].__spec__
    source = spec.loader.get_source(package)  # type: ignore[union-attr]  # a folder of files has a loader of sources
    return {
        alias.name: node.module or ""
        for branch in ast.parse(source).body
        if isinstance(branch, ast.If)
        for node in branch.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
