"""The self_collision file as it is written: pairs of links with a reason, and the geometry that they were found with.

Whether it fits a robot is `self_collision`'s to say; this module reads quickly, for commands that a launch file waits for.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

import pydantic
import yaml

from construction_twin.core.errors import ConfigurationError, problem_of
from construction_twin.core.sentences import Sentence
from construction_twin.core.validation import wrong_value


class PairFile(pydantic.BaseModel):
    """The YAML file; its comments explain the keys."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    robot: str
    geometry: Annotated[str, pydantic.Field(pattern="^[0-9a-f]{64}$")]
    samples: Annotated[int, pydantic.Field(ge=1)]
    seed: Annotated[int, pydantic.Field(ge=0)]
    ignored: tuple[tuple[str, str, Literal["adjacent", "always", "never"]], ...]

    @property
    def reasons(self) -> dict[frozenset[str], str]:
        """Reason of each pair of links that is not checked."""
        return {frozenset((first, second)): why for first, second, why in self.ignored}


def parse_pairs(description: Mapping, where: str) -> PairFile:
    """Return what a parsed file says, without asking which robot it is for.

    Args:
        where: Name of the file, for errors.

    Raises:
        ConfigurationError: If a key is wrong.
    """
    try:
        return PairFile.model_validate(dict(description))
    except pydantic.ValidationError as error:
        wrong = wrong_value(error, PairFile.model_json_schema())
        raise ConfigurationError(f"{where} {wrong.key}", wrong.value, wrong.expected) from error


def read_pairs_yaml(path: str | Path) -> dict:
    """Return the contents of a file, not yet checked.

    Raises:
        ConfigurationError: If it cannot be read, or is no mapping.
    """
    try:
        description = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ConfigurationError(str(path), problem_of(error), Sentence("expected.self_collision.yaml")) from error
    if not isinstance(description, dict):
        raise ConfigurationError(str(path), description, Sentence("expected.self_collision.mapping"))
    return description
