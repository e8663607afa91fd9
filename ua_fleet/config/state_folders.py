"""The folders in which the processes of a fleet keep their state, by names that do not change when they move."""

from __future__ import annotations

from pathlib import Path

from ua_fleet.config.schema import FleetConfig

__all__ = ["lock_files", "state_folders", "unfit_folders"]


def state_folders(config: FleetConfig, config_dir: Path) -> dict[str, Path]:
    """The folders by the names that backups use, whether they are on this machine or not."""
    found = {"server": config.server.state_dir}
    for name in (*config.bridges, *config.relays):
        found[f"{'relay' if name in config.relays else 'bridge'}-{name}"] = config.state_dir_of(name)
    if config.modbus is not None:
        found["modbus"] = config.modbus.state_dir
    found["keys"] = config.pubsub.keys.folder
    found["scenarios"] = config.scenarios.folder
    return {name: (config_dir / folder).resolve() for name, folder in found.items()}


def unfit_folders(config: FleetConfig, config_dir: Path) -> list[str]:
    """Why the folders cannot be backed up and restored apart from each other and from fleet.yaml; empty if they can.

    A restore moves aside what is in a folder, so that of two names of one folder the second loses what the first got.
    """
    home = config_dir.resolve()
    names_of: dict[Path, list[str]] = {}
    for name, folder in state_folders(config, config_dir).items():
        names_of.setdefault(folder, []).append(name)
    problems: list[str] = []
    for folder, names in names_of.items():
        who = " and ".join(names)
        if len(names) > 1:
            problems.append(f"{folder}: is the folder of {who}; give each a folder of its own in fleet.yaml")
        if folder == home or folder in home.parents:
            problems.append(
                f"{folder}: the folder of {who} has fleet.yaml in it; name one that has not, such as ./state"
            )
    return problems


def lock_files(config: FleetConfig, config_dir: Path) -> dict[Path, str]:
    """The files that the processes lock while they run, with what such a process is."""
    found = {config_dir / config.server.state_dir / "server.lock": "the server"}
    for name in (*config.bridges, *config.relays):
        kind = "relay" if name in config.relays else "bridge"
        found[config_dir / config.state_dir_of(name) / f"{name}.lock"] = f"{kind} {name}"
    return found
