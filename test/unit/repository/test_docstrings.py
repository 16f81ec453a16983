"""`scripts/docstrings.py` finds what a docstring says twice, of nothing, or in another form."""

import sys
from pathlib import Path

import griffe
import pytest

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "scripts"))

import docstrings  # noqa: E402

GOOD = '''
class ArmError(Exception):
    """Any."""

class Arm:
    """An arm.

    Args:
        reach, stroke: Of the tip [m].

    Attributes:
        pose: Shape (n,). [rad]
        first, second: Set together.
    """

    def __init__(self, reach: float, stroke: float):
        self.pose = ()
        self.first, self.second = reach, stroke

    def move(self, q: tuple, *parts: str, **more: object) -> float:
        """Move.

        Args:
            q: Shape (n,). Goal [rad].
            *parts: Of the motion.
            **more: For the log.

        Returns:
            Duration [s].

        Raises:
            ArmError: If it cannot.
            ValueError: If q is of another length.
        """
'''
RAISES = GOOD[GOOD.index("Raises:") : GOOD.rindex("\n")].rpartition("\n")[0]


def problems(text: str) -> list[str]:
    file = ROOT / "arm.py"
    module = griffe.visit("arm", filepath=file, code=text)
    file_of = {file: module}
    names = docstrings.Names(file_of, {file: text})
    return docstrings.findings(file, module, names)


def test_what_annotations_cannot_say_is_no_finding():
    assert problems(GOOD) == []


@pytest.mark.parametrize(
    ("good", "bad", "finding"),
    [
        ("q: Shape (n,). Goal", "q (tuple): Goal", "the type of q is in its annotation"),
        ("q: Shape (n,). Goal [rad].", "p: Goal.", "Args names p, which is not there"),
        ("reach, stroke: Of", "reach, strokes: Of", "Args names strokes, which is not there"),
        ("first, second: Set", "first, third: Set", "Attributes names third, which is not there"),
        ("ArmError: If it cannot.", "LegError: If it cannot.", "Raises names LegError, which is not there"),
        ("pose: Shape (n,). [rad]", "pose:", "Attributes has nothing to say of pose"),
        (RAISES, "Raises:\n            ArmError", "Raises has no line"),
        ("Args:\n            q: Shape", "Parameters\n        ----------\n            q: Shape", "Parameters is underlined"),
    ],
)  # fmt: skip
def test_a_finding_says_where_and_what(good, bad, finding):
    assert good in GOOD
    found = problems(GOOD.replace(good, bad))
    assert any(finding in line and line.startswith("arm.py:") for line in found), found


def test_attributes_of_a_base_class_are_known():
    text = (
        GOOD
        + '''

class Rail(Arm):
    """On a rail.

    Attributes:
        pose: Shape (n,). The carriage first [m], [rad].
        first: As above.
    """
'''
    )
    assert problems(text) == []
