"""Draws the arm and the track: writes urdf/meshes/ (COLLADA files and inertias.yaml), or with --check says what would change.

Same source, same bytes. Afterwards test/unit/repository/test_meshes.py checks that the collision shapes enclose what is drawn.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from model.files import all_files

MESHES = Path(__file__).resolve().parent.parent / "urdf" / "meshes"


def main(arguments: list[str]) -> int:
    """Write or check the files; return the exit code: 1 when a check finds a difference."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--check", action="store_true", help="write nothing; exit code 1 when a file is not as it would be written"
    )
    parser.add_argument("--output", type=Path, default=MESHES, help="folder to write to")
    options = parser.parse_args(arguments)
    files = all_files()
    changed = []
    options.output.mkdir(parents=True, exist_ok=True)
    present = {path.name for path in options.output.iterdir()}
    for name, text in files.items():
        path = options.output / name
        if name in present and path.read_text() == text:
            continue
        changed.append(name)
        if not options.check:
            path.write_text(text)
    for name in sorted(present - set(files)):
        changed.append(name)
        if not options.check:
            (options.output / name).unlink()
    print(
        f"{len(files)} files, {sum(map(len, files.values())) // 1000} kB; changed: {', '.join(sorted(changed)) or 'none'}"
    )
    return 1 if options.check and changed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
