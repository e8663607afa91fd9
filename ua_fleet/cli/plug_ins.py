"""Commands of other packages. Each is an entry point of the group `ua_fleet.commands` that names a `typer.Typer`.

The entry point's name is the command's. A package is imported when its command is wanted, or when the help lists it,
and not before. What is wrong with it costs this command alone, which says so in one line.
"""

from __future__ import annotations

from collections.abc import Iterator, MutableMapping
from functools import cached_property
from importlib import metadata
from typing import Any, Final

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from ua_fleet.errors import UaFleetError
from ua_fleet.values import StatusCode

__all__ = ["ENTRY_POINT_GROUP", "CommandUnavailable", "ExtensibleGroup"]

ENTRY_POINT_GROUP: Final = "ua_fleet.commands"


class CommandUnavailable(UaFleetError):
    """The package of a command is missing or broken."""

    ua_status = StatusCode.BAD_CONFIGURATION_ERROR


class ExtensibleGroup(TyperGroup):
    """A group that has the commands of other packages beside its own."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.commands = _Commands(self.commands)


class _Commands(MutableMapping[str, Any]):
    """Commands by their names: the own ones, then those of others. Nothing of another replaces an own one."""

    def __init__(self, own: MutableMapping[str, Any]) -> None:
        self._own = own
        self._loaded: dict[str, Any] = {}

    @cached_property
    def _entries(self) -> metadata.EntryPoints:
        """Looked up when an own command does not do: it reads a file of every package that is installed."""
        return metadata.entry_points(group=ENTRY_POINT_GROUP)

    def __getitem__(self, name: str) -> Any:
        if name in self._own:
            return self._own[name]
        if name not in self._loaded:
            entries = tuple(self._entries.select(name=name))
            if not entries:
                raise KeyError(name)
            try:
                self._loaded[name] = _load(name, entries)
            except CommandUnavailable as problem:
                self._loaded[name] = _unavailable(name, problem)
        return self._loaded[name]

    def __setitem__(self, name: str, command: Any) -> None:
        self._own[name] = command

    def __delitem__(self, name: str) -> None:
        del self._own[name]

    def __iter__(self) -> Iterator[str]:
        yield from self._own
        yield from sorted(self._entries.names - self._own.keys())

    def __len__(self) -> int:
        return len(self._own.keys() | self._entries.names)


def _load(name: str, entries: tuple[metadata.EntryPoint, ...]) -> Any:
    """The command of an entry point; raises CommandUnavailable."""
    packages = [one.dist.name if one.dist is not None else one.module for one in entries]
    entry, *others = entries
    if others:
        raise CommandUnavailable(
            f"the command {name} is brought by {len(entries)} packages: {', '.join(sorted(packages))}; "
            "uninstall all but one of them"
        )
    package = packages[0]
    try:
        found = entry.load()
        if not isinstance(found, typer.Typer):
            raise TypeError(f"{entry.value} is no typer.Typer")
        command = get_command(found)
    except ModuleNotFoundError as error:
        raise CommandUnavailable(
            f"the command {name} needs the package {error.name}, which is not installed; install {package} again, "
            "with all that it needs"
        ) from error
    except (Exception, SystemExit) as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise CommandUnavailable(
            f"the command {name} cannot be loaded: {reason}; report this to the makers of {package}"
        ) from error
    command.name = name
    return command


def _unavailable(name: str, problem: CommandUnavailable) -> Any:
    """Stands for a command that cannot run: whatever it is called with, it says why."""

    def refuse() -> None:
        raise problem

    return TyperCommand(
        name,
        callback=refuse,
        help=f"(not available) {problem}",
        add_help_option=False,
        context_settings={"ignore_unknown_options": True, "allow_extra_args": True},
        rich_markup_mode=None,
    )
