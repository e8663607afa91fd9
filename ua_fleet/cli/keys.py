"""`ua-fleet keys`: the key files of message security, for `pubsub.keys.source: files`."""

from __future__ import annotations

import time
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ua_fleet.cli.endings import NotFound, UsageError
from ua_fleet.cli.options import DEFAULT_CONFIG, Config, Json, load_config
from ua_fleet.cli.output import message, print_json, print_line, print_table
from ua_fleet.errors import ConfigError, TopicInvalid
from ua_fleet.printing import config_option
from ua_fleet.topics import check_space

if TYPE_CHECKING:
    from ua_fleet.config import FleetConfig
    from ua_fleet.storage.key_files import KeyFile, KeyFolder

__all__ = ["CREATE_EXAMPLES", "LIST_EXAMPLES", "ROTATE_EXAMPLES", "create", "rotate", "show"]

CREATE_EXAMPLES = ("ua-fleet keys create", "ua-fleet keys create t-2 c-2 -c hall2.yaml")
ROTATE_EXAMPLES = ("ua-fleet keys rotate", "ua-fleet keys rotate t-2 --after 3600", "ua-fleet keys rotate c-2 --leaked")
LIST_EXAMPLES = ("ua-fleet keys list", "ua-fleet keys list --json -c hall2.yaml")

Groups = Annotated[list[str] | None, typer.Argument(metavar="[GROUP]...", help="SecurityGroups like t-2 or c-2.")]


def _folder(path: Path) -> tuple[FleetConfig, KeyFolder]:
    from ua_fleet.storage.key_files import KeyFolder

    config = load_config(path, allow_missing_ids=True)
    folder = KeyFolder(path.resolve().parent / config.pubsub.keys.folder)
    if not config.is_secured:
        message(f"{path} has pubsub.security: {config.pubsub.security.value}, so no process uses these files")
    elif config.pubsub.keys.source != "files":
        message(f"{path} takes keys from the service; for these files write pubsub.keys.source: files")
    return config, folder


def _checked(groups: list[str] | None) -> list[str]:
    for group_id in groups or []:
        if not _is_group(group_id):
            raise UsageError(
                f"{group_id!r} is no SecurityGroup; name one like t-2 (data of space 2), c-2 (its commands) or r-gate "
                "(a relay)"
            )
    return groups or []


def _is_group(group_id: str) -> bool:
    from ua_fleet.pubsub.security.groups import command_group, is_group, relay_group, telemetry_group

    if group_id.startswith(relay_group("")):
        return is_group(group_id)
    try:
        space = check_space(int(group_id[2:]))
    except (ValueError, TopicInvalid):
        return False
    return group_id in (telemetry_group(space), command_group(space))


def create(groups: Groups = None, config: Config = DEFAULT_CONFIG, as_json: Json = False) -> None:
    """Make the key files that are missing.

    Without names: one for each SecurityGroup of the configuration file. Every process reads the same files. Copy to the
    machine of each other bridge only the files that it needs, over a secure channel.
    """
    from ua_fleet.config.security import all_groups
    from ua_fleet.storage.key_files import KeyFile, NoKeyFile
    from ua_fleet.wire.security import SecurityPolicy

    fleet, folder = _folder(config)
    keys = fleet.pubsub.keys
    made = 0
    with folder.exclusive():
        for group_id in _checked(groups) or all_groups(fleet):
            try:
                folder.read(group_id)
            except NoKeyFile:
                folder.write(KeyFile.new(group_id, SecurityPolicy.named(keys.policy), keys.lifetime_s, time.time()))
            else:
                continue
            made += 1
            path = folder.path_of(group_id)
            if as_json:
                print_json({"group": group_id, "created": str(path)})
            else:
                print_line(f"{group_id}  {path}")
    if not made:
        message(f"nothing to do, all key files exist; new keys: ua-fleet keys rotate{config_option()}")


def rotate(
    groups: Groups = None,
    after: Annotated[
        float, typer.Option(help="Seconds until publishers use the new key; readers take it at once.", min=0)
    ] = 10.0,
    leaked: Annotated[
        bool, typer.Option("--leaked", help="The old keys end now. For a second, messages may be lost.")
    ] = False,
    config: Config = DEFAULT_CONFIG,
    as_json: Json = False,
) -> None:
    """Give groups a new key; without names, all groups that have a file.

    Running processes notice the changed file within 1 s and accept messages of the old and of the new key, so that no
    message is lost. If you copy the files to other machines, allow time for that with --after.
    """
    from ua_fleet.storage.key_files import NoKeyFile

    fleet, folder = _folder(config)
    keys = fleet.pubsub.keys
    with folder.exclusive():
        names = _checked(groups) or folder.groups()
        if not names:
            raise NotFound(
                f"there are no key files in {folder.path}; make them with: ua-fleet keys create{config_option()}"
            )
        try:
            files = [folder.read(group_id) for group_id in names]  # all or none
        except NoKeyFile as error:
            raise NotFound(str(error)) from error
        for known in files:
            before, now = replace(known, lifetime_s=keys.lifetime_s), time.time()
            changed = before.replaced(now) if leaked else before.rotated(now, after, keys.past_keys)
            folder.write(changed)
            new = changed.keys[-1]
            if as_json:
                print_json({"group": changed.group_id, "token": new.token_id, "active_from": _time(new.active_from)})
            else:
                print_line(f"{changed.group_id}  token {new.token_id} from {_time(new.active_from)} on")


def show(config: Config = DEFAULT_CONFIG, as_json: Json = False) -> None:
    """List the key files: tokens, age and rights, never a key."""
    from ua_fleet.config.security import all_groups

    fleet, folder = _folder(config)
    rows: list[dict[str, Any]] = []
    problem: ConfigError | None = None
    for group_id in folder.groups():
        path = folder.path_of(group_id)
        rights = f"{path.stat().st_mode & 0o777:o}"
        try:
            rows.append({**_row(folder.read(group_id), time.time()), "rights": rights, "problem": None})
        except ConfigError as error:
            problem = problem or error
            rows.append({"group": group_id, "rights": rights, "problem": error.message})
    if as_json:
        for row in rows:
            print_json(row)
    elif rows:
        print_table([("group", "policy", "tokens", "age", "next key", "rights"), *map(_cells, rows)])
    missing = [group_id for group_id in all_groups(fleet) if group_id not in {row["group"] for row in rows}]
    if missing:
        message(f"without a key file: {', '.join(missing)}; make them with: ua-fleet keys create{config_option()}")
    if problem is not None:
        raise problem


def _time(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="seconds").replace("+00:00", "Z")


def _row(key_file: KeyFile, now: float) -> dict[str, Any]:
    keys = key_file.keys
    at = key_file.current_index(now)
    coming = keys[at + 1].active_from if at + 1 < len(keys) else None
    return {
        "group": key_file.group_id,
        "policy": key_file.policy.short_name,
        "past_tokens": [key.token_id for key in keys[:at]],
        "current_token": keys[at].token_id,
        "future_tokens": [key.token_id for key in keys[at + 1 :]],
        "age_s": round(max(0.0, now - keys[at].active_from), 1),
        "next_key_at": _time(coming) if coming is not None else None,
        "rotation_due_at": _time(keys[at].active_from + key_file.lifetime_s),
        "overdue": coming is None and now > keys[at].active_from + key_file.lifetime_s,
    }


def _age(seconds: float) -> str:
    for unit, length in (("d", 86_400), ("h", 3_600), ("min", 60)):
        if seconds >= 2 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{seconds:.0f} s"


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    if row["problem"] is not None:
        return (row["group"], row["problem"], "", "", "", row["rights"])
    tokens = " ".join([*map(str, row["past_tokens"]), f"[{row['current_token']}]", *map(str, row["future_tokens"])])
    if row["next_key_at"] is not None:
        coming = f"at {row['next_key_at']}"
    else:
        coming = f"{'overdue since' if row['overdue'] else 'due'} {row['rotation_due_at']}"
    return (row["group"], row["policy"], tokens, _age(row["age_s"]), coming, row["rights"])
