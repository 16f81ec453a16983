"""The process that reads one IFC file: `python -m construction_twin.extensions.work.ifc.child FILE SHA256 OUTPUT BYTES MEMORY CPU`.

Its limits are its own and hold before ifcopenshell is imported. It writes the model into OUTPUT and ends with 0; where it cannot,
`[what, found, expected]` as JSON into OUTPUT.error. Whoever starts it believes none of that without a check.
"""

from __future__ import annotations

import json
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
    # after the limits: what is imported is C++ of several hundred MB
    from construction_twin.extensions.work.errors import BuildingError
    from construction_twin.extensions.work.ifc.model_file import save
    from construction_twin.extensions.work.ifc.reader import read_ifc

    def say(*values: str) -> int:
        Path(f"{output}.error").write_text(json.dumps(values))
        return 1

    try:
        model = read_ifc(path, most_bytes)
        if model.digest != digest:
            return say("the file", "other contents when it was read again", "a file that nobody writes")
        save(model, Path(output))
    except BuildingError as error:
        return say(error.what, error.found, error.expected)
    except MemoryError:
        return say("the file", f"more than {memory >> 20} MiB of memory needed", "a smaller model")
    except OSError as error:
        return say("the result", error.strerror or str(error), "room on the disk for it")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
