"""`ua-fleet state`: backups of all that the processes of a fleet have stored."""

from __future__ import annotations

import contextlib
from collections.abc import Generator
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from ua_fleet import __version__
from ua_fleet.cli.endings import NotFound, UsageError
from ua_fleet.cli.options import DEFAULT_CONFIG, Config, Json, load_config
from ua_fleet.cli.output import message, print_json, print_line
from ua_fleet.printing import config_option

if TYPE_CHECKING:
    from ua_fleet.config import FleetConfig
    from ua_fleet.storage.state_files import Manifest

__all__ = ["BACKUP_EXAMPLES", "CHECK_EXAMPLES", "RESTORE_EXAMPLES", "backup", "check", "restore"]

BACKUP_EXAMPLES = ("ua-fleet state backup /backup/hall-2026-03-01.tar",)
CHECK_EXAMPLES = ("ua-fleet state check /backup/hall-2026-03-01.tar",)
RESTORE_EXAMPLES = ("ua-fleet state restore /backup/hall-2026-03-01.tar",)
_SECRETS: Final = "it contains private keys and the hashes of passwords: keep it where you would keep these"

File = Annotated[Path, typer.Argument(help="The backup.", show_default=False)]


def backup(file: File, config: Config = DEFAULT_CONFIG, as_json: Json = False) -> None:
    """Write a backup of the state of all processes of this machine, while they run.

    It has the folders that the configuration names: `state_dir` of the server, the bridges, the relays and the Modbus
    gateway, `pubsub.keys.folder` and `scenarios.folder`. Run it as the user of these processes. The configuration
    itself, files that it refers to, and a history in PostgreSQL are not in it.
    """
    from ua_fleet.storage.state_backup import write_backup
    from ua_fleet.storage.state_files import Manifest

    fleet = load_config(config, allow_missing_ids=True)
    folders = _folders(fleet, config.resolve().parent)
    if not any(folder.is_dir() for folder in folders.values()):
        raise NotFound(f"{config}: no process of this fleet has stored anything on this machine")
    made = datetime.now(UTC).isoformat(timespec="seconds")
    manifest = write_backup(file, folders, Manifest(fleet.fleet.name, made, __version__, _postgres(fleet), {}))
    _print(file, manifest, as_json=as_json, size=file.stat().st_size)
    message(_SECRETS)
    if manifest.postgres:
        message(f"the history is not in it; save that with: {_dump(manifest.postgres)}")


def check(file: File, as_json: Json = False) -> None:
    """Check a backup: that it is whole, that nothing in it was changed, and that its databases are intact.

    The backup is unpacked into a folder beside it for that, which needs as much room, and is removed again.
    """
    from ua_fleet.storage.state_restore import unpacked

    _check_there(file)
    with unpacked(file, __version__, file.resolve().parent) as (manifest, _):
        _print(file, manifest, as_json=as_json, size=file.stat().st_size)


def restore(
    file: File,
    despite_open_work: Annotated[
        bool,
        typer.Option(
            "--despite-open-work", help="Restore runs and requests that had no end, once you know what the robots do."
        ),
    ] = False,
    config: Config = DEFAULT_CONFIG,
    as_json: Json = False,
) -> None:
    """Put the state of a backup in the place of what is there. No process of the fleet may run on this machine.

    What was there is moved into a folder `before-restore-TIME` in each state folder. What the robots did after the
    backup is not in it: requests without an end are asked after, and not sent again. All keys of message security
    count as used up.
    """
    from ua_fleet.storage.state_restore import open_work, put_in_place, unpacked

    _check_there(file)
    fleet, folder = load_config(config, allow_missing_ids=True), config.resolve().parent
    folders = _folders(fleet, folder)
    with _nobody_runs(fleet, folder), unpacked(file, __version__, folder) as (manifest, within):
        if manifest.fleet != fleet.fleet.name:
            raise UsageError(f"{file} is of the fleet {manifest.fleet!r}, and {config} of {fleet.fleet.name!r}")
        work = open_work(within)
        if any(work) and not despite_open_work:
            raise UsageError(
                f"{file}: {work.runs} runs and {work.requests} requests to robots had no end; see what the robots are"
                f" doing, then restore with --despite-open-work"
            )
        restored = put_in_place(within, folders, manifest, datetime.now(UTC))
    _print(file, manifest, as_json=as_json, size=file.stat().st_size)
    for path in restored.aside:
        message(f"what was there before: {path}")
    for path in restored.broken:
        message(f"{path}: was broken before the backup, and is restored as it was; its process says the remedy")
    _tell_what_to_do(fleet, manifest)


def _folders(fleet: FleetConfig, folder: Path) -> dict[str, Path]:
    """The folders of the state; UsageError where they cannot be told apart, before anything is written or moved."""
    from ua_fleet.config.state_folders import state_folders, unfit_folders

    if problems := unfit_folders(fleet, folder):
        raise UsageError(problems[0])
    return state_folders(fleet, folder)


def _tell_what_to_do(fleet: FleetConfig, manifest: Manifest) -> None:
    if fleet.is_secured and fleet.pubsub.keys.from_server:
        message("keys of message security are made anew; start the server, then start all bridges and relays again")
    elif fleet.is_secured:
        message(
            "nothing is sent with the keys there are; make new ones before you start: "
            f"ua-fleet keys rotate{config_option()}"
        )
    if manifest.postgres:
        message(f"the history is in {manifest.postgres}; restore it with pg_restore, or leave it as it is")


@contextlib.contextmanager
def _nobody_runs(fleet: FleetConfig, folder: Path) -> Generator[None]:
    """Keep all processes of the fleet from starting on this machine; StorageUnavailable where one runs."""
    from ua_fleet.config.state_folders import lock_files, state_folders
    from ua_fleet.errors import StorageUnavailable
    from ua_fleet.storage.control import SUFFIX, held_by
    from ua_fleet.storage.process_lock import process_lock

    with contextlib.ExitStack() as cleanup:
        for path, what in lock_files(fleet, folder).items():
            if path.parent.is_dir() or what == "the server":
                cleanup.enter_context(process_lock(path, what, restores=True))
        for place in [path for each in state_folders(fleet, folder).values() for path in each.glob(f"*{SUFFIX}")]:
            with held_by(place) as process:
                if process is not None:
                    raise StorageUnavailable(f"{place}: its process runs; stop it first")
        yield


def _check_there(file: Path) -> None:
    if not file.is_file():
        raise NotFound(f"{file}: there is no such file")


def _postgres(fleet: FleetConfig) -> str:
    """The database that has the history, without what may be a secret."""
    store = None if fleet.history is None else fleet.history.store
    return "" if store is None else store.partition("?")[0]


def _dump(store: str) -> str:
    return f"pg_dump --format=custom --schema=ua_fleet_history --file=history.dump {store}"


def _print(file: Path, manifest: Manifest, *, as_json: bool, size: int) -> None:
    if as_json:
        shown: dict[str, Any] = {**manifest._asdict(), "files": sorted(manifest.files)}
        print_json({"file": str(file), "bytes": size, **shown})
        return
    print_line(f"{file}: {len(manifest.files)} files of {manifest.fleet}, {size / 1e6:.1f} MB, made {manifest.made}")
