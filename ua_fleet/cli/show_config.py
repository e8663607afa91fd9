"""`ua-fleet config show`: the configuration as it is in force."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ua_fleet.cli.endings import NotFound
from ua_fleet.cli.options import DEFAULT_CONFIG, Config, Json
from ua_fleet.cli.output import print_json, print_table
from ua_fleet.printing import config_option

if TYPE_CHECKING:
    from ua_fleet.config.show import ShownSetting

__all__ = ["SHOW_EXAMPLES", "show"]

SHOW_EXAMPLES = (
    "ua-fleet config show",
    "ua-fleet config show server pubsub.security --origin",
    "UA_FLEET__SERVER__PORT=4841 ua-fleet config show server.port --json",
)


def show(
    keys: Annotated[list[str] | None, typer.Argument(help="Only these keys, e.g. server.port.")] = None,
    origin: Annotated[bool, typer.Option("--origin", help="Show the origin of each value.")] = False,
    config: Config = DEFAULT_CONFIG,
    as_json: Json = False,
) -> None:
    """Print the configuration as it is in force, as YAML.

    Defaults are filled in, and so are values of UA_FLEET__SERVER__PORT and the like. What comes from ${NAME} is shown
    as the file has it. With --origin: file and line, environment variable, or default.
    """
    from ua_fleet.config.load import load_document, read_content
    from ua_fleet.config.show import as_tree, as_yaml, settings

    fleet, document = load_document(read_content(config), str(config), os.environ, allow_missing_ids=True)
    found = _wanted(settings(fleet, document), keys or [], config)
    if origin and as_json:
        for setting in found:
            print_json({"key": setting.key, "value": setting.value, "origin": _origin_as_json(setting)})
    elif origin:
        rows = [(setting.key, _text_of(setting.value), setting.origin) for setting in found]
        print_table([("key", "value", "from"), *rows])
    elif as_json:
        print_json(as_tree(found))
    else:
        sys.stdout.write(as_yaml(found, list(document.variables.values())))


def _wanted(found: list[ShownSetting], keys: list[str], config: Path) -> list[ShownSetting]:
    from ua_fleet.config.show import nearest_key

    for key in keys:
        if not any(setting.is_below(key) for setting in found):
            hint = nearest_key(key, found) or f"see all: ua-fleet config show{config_option()}"
            raise NotFound(f"{config}: `{key}` has no value; {hint}")
    return [setting for setting in found if not keys or any(setting.is_below(key) for key in keys)]


def _origin_as_json(setting: ShownSetting) -> dict[str, Any]:
    place = setting.place
    if place is None:
        return {"default": True}
    return {"environment": place.key} if place.key else {"file": place.file, "line": place.line}


def _text_of(value: Any) -> str:
    from json import dumps

    return value if isinstance(value, str) else dumps(value, ensure_ascii=False)
