"""The commented file that `ua-fleet config init` writes."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from ua_fleet.errors import ConfigError

__all__ = ["default_content", "write_default"]


def default_content() -> bytes:
    """The file's bytes. `pubsub.security` is left to be decided, so it is not valid as it stands."""
    return files("ua_fleet.config").joinpath("default_fleet.yaml").read_bytes()


def write_default(path: Path) -> None:
    """Write the file; raises ConfigError where there is one already or the folder cannot be written."""
    try:
        with path.open("xb") as file:
            file.write(default_content())
    except FileExistsError as error:
        raise ConfigError("exists already", file=str(path), suggestion="choose another name") from error
    except OSError as error:
        reason = (error.strerror or "it").lower()
        raise ConfigError(f"cannot be written: {reason}", file=str(path)) from error
