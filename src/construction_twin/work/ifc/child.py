"""The process that reads one IFC file: `python -m construction_twin.work.ifc.child FILE SHA256 OUTPUT BYTES MEMORY CPU`.

Its limits are its own and hold before ifcopenshell is imported. It writes the model into OUTPUT and ends with 0, and lines of JSON
to standard output: `{"progress": [what, done, all]}` while it reads, `{"error": [what, found, expected]}` where it cannot.
Whoever starts it believes none of that without a check.
"""

from __future__ import annotations

import json
import os
import resource
import sys
from pathlib import Path


def main(arguments: list[str]) -> int:
    """Read a file and write what is in it.

    Args:
        arguments: File, its SHA-256, output, and the bounds: its largest size [bytes], memory [bytes], processor time [s].

    Returns:
        The exit code.
    """
    path, digest, output = arguments[:3]
    most_bytes, memory, cpu = map(int, arguments[3:])
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    resource.setrlimit(resource.RLIMIT_CPU, (cpu, cpu + 5))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    # what C++ writes to standard output is no message
    pipe = os.dup(1)
    os.dup2(2, 1)
    # after the limits: what is imported is C++ of several hundred MB
    from construction_twin.core.sentences import Sentence
    from construction_twin.core.work_errors import BuildingError
    from construction_twin.work.ifc.model_file import save
    from construction_twin.work.ifc.reader import read_ifc

    def say(kind: str, *values: str | int) -> None:
        os.write(pipe, json.dumps({kind: values}).encode() + b"\n")

    try:
        model = read_ifc(path, most_bytes, lambda *step: say("progress", *step))
        if model.digest != digest:
            say("error", Sentence("ifc.file"), Sentence("ifc.found.changed_again"), Sentence("ifc.nobody_writes"))
            return 1
        save(model, Path(output))
    except BuildingError as error:
        say("error", error.what, error.found, error.expected)
        return 1
    except MemoryError:
        say("error", Sentence("ifc.file"), Sentence("ifc.found.memory", memory=memory >> 20), Sentence("ifc.smaller"))
        return 1
    except OSError as error:
        say("error", Sentence("ifc.result"), error.strerror or str(error), Sentence("ifc.room"))
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
