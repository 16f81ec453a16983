"""GNU Octave for tests of matlab/: it parses MATLAB's language, and runs what needs no toolbox."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MATLAB = ROOT / "matlab"
#: Functions of the toolboxes, so far as matlab/ calls them.
STUBS = Path(__file__).resolve().parent / "matlab_stubs"
#: A marker of our own, because Octave 7 may end with 0 after an error and print an error after its end.
_DONE = "the end was reached"


def octave(code: str, folder: Path) -> str:
    """Run code in a folder and return what it prints; AssertionError with Octave's words when it stops at an error."""
    script = folder / "run.m"
    paths = "".join(f"addpath('{path}');\n" for path in (STUBS, MATLAB))
    script.write_text(f"1;\n{paths}{code}\ndisp('{_DONE}');\n")
    assert shutil.which("octave-cli"), "GNU Octave is not installed; `setup/setup.sh tests` installs it"
    command = ["octave-cli", "--norc", "--no-history", str(script)]
    run = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120.0)
    assert _DONE in run.stdout, f"octave: {run.stderr}\n{run.stdout}"
    return run.stdout.replace(_DONE, "").strip()


def parse_errors(files: list[Path], folder: Path) -> dict[str, str]:
    """Return what Octave's parser says of each file that it cannot parse."""
    names = ", ".join(f"'{file}'" for file in files)
    loop = f"""files = {{{names}}};
for k = 1:numel(files)
  try
    __parse_file__(files{{k}});
    printf('parsed %s\\n', files{{k}});
  catch problem
    printf('wrong %s: %s\\n', files{{k}}, strrep(problem.message, sprintf('\\n'), ' '));
  end
end"""
    said = octave(loop, folder)
    assert said.count("parsed ") + said.count("wrong ") == len(files), said
    return dict(re.findall(r"^wrong (\S+): (.*)$", said, re.MULTILINE))
