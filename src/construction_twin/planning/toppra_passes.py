"""What planning uses of toppra, without what toppra would load beside it.

`import toppra` imports matplotlib's pyplot, for plots of its own that nothing here asks for: a quarter of a second in each process
that plans or checks a plan, so in every start. While toppra is imported two empty modules stand where pyplot would be; whoever
draws later imports the real ones.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

_DRAWS = ("matplotlib", "matplotlib.pyplot")


@contextmanager
def _without_drawing() -> Iterator[None]:
    absent = [name for name in _DRAWS if name not in sys.modules]
    sys.modules.update({name: ModuleType(name) for name in absent})
    try:
        yield
    finally:
        for name in absent:
            del sys.modules[name]


with _without_drawing():
    from toppra.constraint.linear_constraint import LinearConstraint, canlinear_colloc_to_interpolate
    from toppra.solverwrapper.cy_seidel_solverwrapper import seidelWrapper

__all__ = ["LinearConstraint", "canlinear_colloc_to_interpolate", "seidelWrapper"]
