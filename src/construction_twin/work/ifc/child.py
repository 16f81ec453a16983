"""The process that reads one IFC file: `python -m construction_twin.work.ifc.child FILE OUTPUT BYTES MEMORY CPU FD`.

Its limits are its own and hold before ifcopenshell is imported. It writes the model into OUTPUT, and lines of JSON into the
pipe FD: `{"progress": [what, done, all]}` while it reads, and at the end `{"ok": SHA-256}` or `{"error": [what, found, expected]}`.
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
        arguments: File, output, and the bounds: its largest size [bytes], memory [bytes], processor time [s], and the number of the
            pipe.

    Returns:
        The exit code.
    """
    path, output = arguments[:2]
    most_bytes, memory, cpu, pipe = map(int, arguments[2:])
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    resource.setrlimit(resource.RLIMIT_CPU, (cpu, cpu + 5))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    # after the limits: what is imported is C++ of several hundred MB
    from construction_twin.core.work_errors import BuildingError
    from construction_twin.work.ifc.model_file import save
    from construction_twin.work.ifc.reader import read_ifc

    def say(**message: object) -> None:
        os.write(pipe, json.dumps(message).encode() + b"\n")

    try:
        model = read_ifc(path, most_bytes, lambda what, done, whole: say(progress=[what, done, whole]))
        save(model, Path(output))
    except BuildingError as error:
        say(error=[error.what, error.found, error.expected])
        return 1
    except MemoryError:
        say(error=["the file", f"more than {memory >> 20} MiB of memory needed", "a smaller model"])
        return 1
    except OSError as error:
        say(error=["the result", error.strerror or str(error), "room on the disk for it"])
        return 1
    say(ok=model.digest)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
