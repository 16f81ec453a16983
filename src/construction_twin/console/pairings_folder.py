"""The folder of the console's paired devices: whether the console can use it. It changes nothing, and needs no package."""

from __future__ import annotations

import os
import pwd
from pathlib import Path

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.files import check_writable
from construction_twin.core.sentences import Sentence

#: Its folders of files; beside them stand the files `secret` and `lock`.
INVITATIONS, DEVICES = "invitations", "devices"


def check_pairings_folder(folder: Path) -> None:
    """Check a folder as the console will use it, as the user of this process; it need not exist yet.

    Raises:
        ConfigurationError: When it is no folder and cannot be made, belongs to somebody else, others may read it, or something in
            it cannot be read and written.
    """
    try:
        there = folder.stat() if os.path.lexists(folder) else None
    except OSError as error:
        raise ConfigurationError("--pairings", _why(error), Sentence("expected.pairings.folder")) from error
    if there is not None and not folder.is_dir():
        raise ConfigurationError("--pairings", str(folder), Sentence("expected.pairings.folder"))
    if there is not None:
        _check_owner(folder, there)
    try:
        check_writable(folder)
    except ConfigurationError as error:
        raise ConfigurationError("--pairings", error.value, Sentence("expected.pairings.folder")) from error
    for path in (folder / "secret", folder / "lock", folder / INVITATIONS, folder / DEVICES):
        _check_usable(path, path.name in (INVITATIONS, DEVICES))
    for path in (*(folder / INVITATIONS).glob("*"), *(folder / DEVICES).glob("*")):
        _check_usable(path, False)


def _check_owner(folder: Path, there: os.stat_result) -> None:
    if there.st_uid != os.geteuid():
        found = f"{folder}, of user {_name(there.st_uid)}"
        raise ConfigurationError("--pairings", found, Sentence("expected.pairings.owner", user=_name(os.geteuid())))
    mode = there.st_mode & 0o777
    if mode & 0o077 or mode & 0o700 != 0o700:
        raise ConfigurationError("--pairings", f"{folder}, mode {mode:o}", Sentence("expected.pairings.private"))


def _check_usable(path: Path, is_folder: bool) -> None:
    """Refuse what is there and cannot be used by this user."""
    if not os.path.lexists(path):
        return
    needed = os.R_OK | os.W_OK | (os.X_OK if is_folder else 0)
    if path.is_dir() != is_folder or not os.access(path, needed):
        raise ConfigurationError(
            "--pairings", str(path), Sentence("expected.pairings.usable", user=_name(os.geteuid()))
        )


def _name(user: int) -> str:
    try:
        return pwd.getpwuid(user).pw_name
    except KeyError:
        return str(user)


def _why(error: OSError) -> str:
    return f"{error.filename}: {error.strerror}"
