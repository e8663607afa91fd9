"""The folders in which the processes of a fleet keep their state, by names that do not change when they move."""

from __future__ import annotations

from pathlib import Path

from ua_fleet.config.schema import FleetConfig

__all__ = ["lock_files", "state_folders"]


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


def lock_files(config: FleetConfig, config_dir: Path) -> dict[Path, str]:
    """The files that the processes lock while they run, with what such a process is."""
    found = {config_dir / config.server.state_dir / "server.lock": "the server"}
    for name in (*config.bridges, *config.relays):
        kind = "relay" if name in config.relays else "bridge"
        found[config_dir / config.state_dir_of(name) / f"{name}.lock"] = f"{kind} {name}"
    return found
