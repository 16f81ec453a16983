"""How much an object holds, for tests of what must not grow."""

from __future__ import annotations

import gc
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType

_ELSEWHERE = (type, ModuleType, FunctionType, BuiltinFunctionType, MethodType)


def size(held: object) -> int:
    """Return how many objects an object holds, directly and through others; classes, modules and callbacks hold none."""
    seen = {id(held): held}
    waiting = [held]
    while waiting:
        for each in gc.get_referents(waiting.pop()):
            if id(each) not in seen and not isinstance(each, _ELSEWHERE):
                seen[id(each)] = each
                waiting.append(each)
    return len(seen)
