"""The commented file that `ua-fleet config init` writes, and the schema beside it."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from ua_fleet.errors import ConfigError

__all__ = ["default_content", "write_default", "write_schema", "write_text"]


def default_content() -> bytes:
    """The file's bytes. `pubsub.security` is left to be decided, so it is not valid as it stands."""
    return files("ua_fleet.config").joinpath("default_fleet.yaml").read_bytes()


def write_default(path: Path) -> None:
    """Write the file; raises ConfigError where there is one already or the folder cannot be written."""
    try:
        with path.open("xb") as file:
            try:
                file.write(default_content())
                file.flush()
            except BaseException:
                path.unlink(missing_ok=True)  # what is there would be refused the next time
                raise
    except FileExistsError as error:
        raise ConfigError("exists already", file=str(path), suggestion="choose another name") from error
    except OSError as error:
        reason = (error.strerror or "it").lower()
        raise ConfigError(f"cannot be written: {reason}", file=str(path)) from error


def write_schema(folder: Path) -> Path:
    """Write the schema that the file's first line names into its folder, over an older one; raises ConfigError."""
    from ua_fleet.config.json_schema import SCHEMA_FILE, fleet_schema, schema_text

    path = folder / SCHEMA_FILE
    write_text(path, schema_text(fleet_schema()))
    return path


def write_text(path: Path, text: str) -> None:
    """Write a text over what is there; raises ConfigError where that cannot be."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        reason = (error.strerror or "it").lower()
        raise ConfigError(f"cannot be written: {reason}", file=str(path)) from error
