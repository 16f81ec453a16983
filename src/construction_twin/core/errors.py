"""The package's exceptions: what happened, the value, what was expected, what to do. Only ``ros/`` and the commands catch them."""

from __future__ import annotations

import errno

from construction_twin.core.sentences import Quantity, Sentence


class ConstructionTwinError(Exception):
    """Root of every error this package raises. `str` of one that was raised with a `Sentence` is that `Sentence`."""

    def __str__(self) -> str:
        return self.args[0] if len(self.args) == 1 and isinstance(self.args[0], Sentence) else super().__str__()


#: Characters of a value that an error shows: the content of a wrong file would hide what is said of it.
_MOST_SHOWN = 300


def found_and_expected(where: str, value: object, expected: str) -> str:
    """Return the sentence of a wrong value and what was expected; value None: missing."""
    found = "nothing" if value is None else repr(value)
    if len(found) > _MOST_SHOWN:
        found = f"{found[: _MOST_SHOWN - 3]}..."
    return f"{where}: found {found}, expected {expected}"


class ConfigurationError(ConstructionTwinError):
    """A parameter, file or robot description is invalid; `value` None: missing."""

    def __init__(self, where: str, value: object, expected: str):
        self.where, self.value, self.expected = where, value, expected
        super().__init__(found_and_expected(where, value, expected))


class FileError(ConstructionTwinError):
    """A file cannot be read or written; `path` "": unknown."""

    def __init__(self, path: str, error: OSError | UnicodeDecodeError):
        self.path = path
        if isinstance(error, UnicodeDecodeError):
            super().__init__(f"{path} is no text in UTF-8 from byte {error.start} on; name a text file")
            return
        to_do = _FILE_PROBLEMS.get(error.errno or 0)
        super().__init__(to_do.format(path=path or str(error)) if to_do else f"{path}: {system_message(error)}")


#: What opening a file raises that is not there, or may not be read: nothing is known of its contents.
NOT_OPENED = (FileNotFoundError, NotADirectoryError, IsADirectoryError, PermissionError)
_MISSING = "{path} is not there; check the name, and the folder that it is sought in"
_DENIED = "{path} may not be used by this user; check its permissions, or take another place"
#: What to say of the problems with files that a person can do something about.
_FILE_PROBLEMS = {
    errno.ENOENT: _MISSING,
    errno.ENOTDIR: _MISSING,
    errno.EISDIR: "{path} is a folder; name a file",
    errno.EACCES: _DENIED,
    errno.EPERM: _DENIED,
    errno.EROFS: _DENIED,
    errno.ENOSPC: "there is no space left for {path}; make room, or take another disk",
}


def system_message(error: Exception) -> str:
    """Return an OSError's text without number and file name."""
    return getattr(error, "strerror", None) or str(error)


def command_message(error: Exception) -> str:
    """Return an error's text for a terminal: an OSError's as `FileError`."""
    if isinstance(error, OSError):
        # two names: of a file that was renamed, or linked
        return str(FileError(" -> ".join(str(name) for name in (error.filename, error.filename2) if name), error))
    return str(error)


class ReviewError(ConstructionTwinError):
    """A verdict is refused: wrong plan, wrong hash, no reviewer, or the wrong moment."""


class ExpiredError(ReviewError):
    """A person's approval is older than its lifetime (`core.freshness`)."""


class RecordError(ReviewError):
    """A verdict is refused because it cannot be recorded."""

    def __init__(self, path: str, problem: str):
        super().__init__(
            Sentence(
                "{path}: {problem}; nothing is approved without a record, mend it and approve again",
                path=path,
                problem=problem,
            )
        )


class ExecutionError(ConstructionTwinError):
    """A pause or a resume is refused in the executor's present state."""


class MotionRefused(ConstructionTwinError):
    """A setpoint fails the motion check; `joint` "": as a whole; value, limit in SI, nan: none.

    `reason` is a counter: ``range``, ``velocity``, ``acceleration``, ``braking_room``, ``start``, ``order``, ``lead``, ``values``.
    """

    def __init__(self, reason: str, joint: str, value: float, limit: float, unit: str = "rad"):
        self.reason = reason
        self.joint = joint
        self.value = value
        self.limit = limit
        super().__init__(
            Sentence(
                "{subject}{check} check failed: {value} against {limit}",
                subject=f"{joint}: " if joint else "",
                check=reason,
                value=Quantity(value, unit),
                limit=Quantity(limit, unit),
            )
        )


class ProtocolError(ConstructionTwinError):
    """A message from a network does not follow its protocol; `reason` is a counter, such as ``length``, ``xml``, ``number``."""

    def __init__(self, reason: str, message: str):
        self.reason = reason
        super().__init__(message)


class PayloadError(ProtocolError):
    """An MQTT payload or its properties are not what the interface says."""


class TelegramError(ProtocolError):
    """An RSI telegram is not what the protocol says."""


class PoseUnknownError(ConstructionTwinError):
    """The robot's pose is missing or stale."""

    def __init__(self, topic: str, age: float, oldest: float):
        found = "nothing was received" if age == float("inf") else f"the last one is {age:.3f} s old"
        super().__init__(
            f"the pose on {topic} is not known: {found}; expected one at most {oldest:g} s old, check that the twin runs"
        )


class RequestRefused(ConstructionTwinError):
    """The running system refused a request; the message is its answer."""


class SilenceError(ConstructionTwinError):
    """No answer: the system is down, or has another name."""

    def __init__(self, where: str, problem: str, to_do: str):
        super().__init__(f"{where}: {problem}; {to_do}")
