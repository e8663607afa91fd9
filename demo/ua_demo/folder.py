"""What two demonstrations on one machine must not share: the folder, and the ROS 2 domain.

The folder of one that stays up is kept, since clients remember its server's certificate.
"""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from ua_fleet.errors import ConfigError
from ua_fleet.topics import LAST_ROS2_SPACE, check_ros2_space

__all__ = ["claim_domain", "claim_domains", "run_folder"]

FIRST_DOMAIN = 2


@contextmanager
def run_folder(wanted: Path | None, name: str, *, keep: bool) -> Generator[Path]:
    """A folder for one run.

    Args:
        wanted: the user's choice.
        name: of the demonstration.
        keep: without a choice, use the one folder in `$XDG_STATE_HOME` that all such runs share, unless another run has
            it now. Otherwise a temporary one is made, and removed at the end.

    Raises:
        ConfigError: another run has the folder that is wanted.
    """
    if wanted is not None:
        folder = _made(wanted)
        with ExitStack() as held:
            if not _lock(folder / "lock", held):
                raise ConfigError(
                    "another demonstration runs in this folder", file=str(folder), suggestion="choose another --folder"
                )
            yield folder
        return
    if keep:
        base = os.environ.get("XDG_STATE_HOME") or str(Path.home() / ".local" / "state")
        shared = _made(Path(base) / "ua-fleet" / f"demo-{name}")
        with ExitStack() as held:
            if _lock(shared / "lock", held):
                yield shared
                return
    with tempfile.TemporaryDirectory(prefix=f"ua-fleet-{name}-") as temporary:
        yield Path(temporary)


@contextmanager
def claim_domain(wanted: int, say: Callable[[str], None]) -> Generator[int]:
    """The ROS 2 domain `wanted`, or the next one that no other demonstration of this user has, which is said."""
    check_ros2_space(wanted)
    folder = _made(Path(tempfile.gettempdir()) / f"ua-fleet-demo-domains-{os.getuid()}")
    with ExitStack() as held:
        for domain in (*range(wanted, LAST_ROS2_SPACE + 1), *range(2, wanted)):
            if _lock(folder / str(domain), held):
                if domain != wanted:
                    say(f"another demonstration uses ROS 2 domain {wanted}; this one uses {domain}")
                yield domain
                return
    raise ConfigError("every ROS 2 domain is in use by a demonstration")


@contextmanager
def claim_domains(wanted: Sequence[int], count: int, say: Callable[[str], None]) -> Generator[list[int]]:
    """So many ROS 2 domains, each this run's alone: those that are wanted, then the next ones that are free."""
    with ExitStack() as held:
        taken = [held.enter_context(claim_domain(domain, say)) for domain in wanted[:count]]
        while len(taken) < count:
            after = taken[-1] + 1 if taken else FIRST_DOMAIN
            taken.append(held.enter_context(claim_domain(after, _say_nothing)))
        yield taken


def _say_nothing(_text: str) -> None:
    """Nobody has asked for a certain domain."""


def _lock(path: Path, held: ExitStack) -> bool:
    """Lock a file until `held` is closed, unless another process has it."""
    file = held.enter_context(path.open("w"))
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _made(folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"cannot make this folder: {error.strerror}", file=str(folder)) from error
    return folder
