"""How a command ends: exit codes, and errors that only the command line has."""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Generator, Sequence
from typing import Final

from ua_fleet.errors import (
    BridgeUnavailable,
    ConfigError,
    ConfigInvalid,
    NotConnected,
    RobotOffline,
    SendTimeout,
    SkillTimeout,
    StorageUnavailable,
    TopicInvalid,
    TransportError,
    UaFleetError,
)
from ua_fleet.values import StatusCode

__all__ = ["EXIT_FAILED", "NotFound", "UsageError", "UsageProblems", "exit_code_of", "extra_needed", "storage_error"]

EXIT_FAILED: Final = 1
EXIT_USAGE: Final = 2
EXIT_NOT_FOUND: Final = 3
EXIT_UNREACHABLE: Final = 4
EXIT_TIMEOUT: Final = 5


class NotFound(UaFleetError):
    """There is nothing of that name."""

    ua_status = StatusCode.BAD_NODE_ID_UNKNOWN
    remedy = "Take a name from those that the message lists; `ua-fleet browse` shows all nodes."


class UsageError(UaFleetError):
    """The command cannot do anything with what it was given."""

    ua_status = StatusCode.BAD_CONFIGURATION_ERROR
    remedy = "Correct the command; `--help` after it shows its options."


class UsageProblems(UsageError):
    """The command cannot do anything with a file that it was given, for several reasons, each with its line."""

    def __init__(self, problems: Sequence[str]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(self.problems))


def exit_code_of(error: UaFleetError) -> int:
    """The exit code that an error ends the command with."""
    if isinstance(error, ConfigError | ConfigInvalid | TopicInvalid | BridgeUnavailable):
        return EXIT_USAGE
    if isinstance(error, SendTimeout | SkillTimeout):
        return EXIT_TIMEOUT
    if isinstance(error, NotConnected | TransportError | RobotOffline):
        return EXIT_UNREACHABLE
    if error.ua_status in (
        StatusCode.BAD_CONFIGURATION_ERROR,
        StatusCode.BAD_TYPE_MISMATCH,
        StatusCode.BAD_INVALID_ARGUMENT,
    ):
        return EXIT_USAGE
    if error.ua_status in (StatusCode.BAD_NODE_ID_UNKNOWN, StatusCode.BAD_NODE_ID_INVALID):
        return EXIT_NOT_FOUND
    return EXIT_FAILED


_REMEDIES: Final = {
    errno.EACCES: "run this as the user that the files belong to",
    errno.EPERM: "run this as the user that the files belong to",
    errno.ENOSPC: "make room on that disk",
    errno.EDQUOT: "make room on that disk",
    errno.EROFS: "name a folder that can be written, or mount that disk for writing",
}
_OF_DISKS: Final = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)
"""What says nothing but of files, where none is named; a socket may be refused for lack of rights, too."""
_OTHER_REMEDY: Final = "see that it is a file or folder that this user can read and write"


def storage_error(error: OSError) -> StorageUnavailable | None:
    """What a file's error says to a person; None where it is of no file, and so a mistake of ours."""
    if error.filename is None and error.errno not in _OF_DISKS:
        return None
    what = error.filename if error.filename is not None else "a file"
    remedy = _REMEDIES.get(error.errno or 0, _OTHER_REMEDY)
    return StorageUnavailable(f"{what}: {(error.strerror or str(error)).lower()}; {remedy}")


@contextlib.contextmanager
def extra_needed(what: str, extra: str) -> Generator[None]:
    """Say which extra to install when an import inside fails for a package that is not ours."""
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name is None or error.name.startswith(("ua_fleet", "ua_bridges")):
            raise
        raise BridgeUnavailable(f"{what} needs the package {error.name}", extra=extra) from error
