"""Where a value stands in a Unified Namespace: topics that are made from a template.

    {site}/{fleet}/{robot}/{data}     plant/Fleet/carrier/battery.volts     a value, by the name that all tools use
                                      plant/Fleet/carrier/_state            what the server says of the robot
                                      plant/Fleet/_server                   what the broker says of the server

Each placeholder is a whole level, and a template has `{robot}` and `{data}`. Names of robots are unique in a fleet and
names of values in a robot, so no two values share a topic, whatever the template is and whichever robots come later.
Names begin with a letter: what begins with `_` is never one of somebody else's.
"""

from __future__ import annotations

import re
from typing import Final

from ua_fleet.fleet.model import DataSetModel, FieldModel
from ua_fleet.names import closest
from ua_fleet.transport.mqtt.topics import level_of

__all__ = ["DEFAULT_TEMPLATE", "SERVER", "NamespaceTopics", "template_problem"]

DEFAULT_TEMPLATE: Final = "{site}/{fleet}/{robot}/{data}"
SERVER: Final = "_server"
"""The level that says whether the server is there."""
MOST_BYTES: Final = 512
"""Of a template, and of a site. The names that are filled in are 258 characters at most."""
_PLACEHOLDERS: Final = ("site", "fleet", "robot", "data")
_OF_A_VALUE: Final = ("{robot}", "{data}")
_PLACEHOLDER: Final = re.compile(r"\{([^{}]*)\}")


def template_problem(template: str, site: str | None) -> str:
    """What is wrong with a template and the site that it names; empty where nothing is."""
    levels = template.split("/")
    for level in levels:
        if problem := _level_problem(level):
            return problem
    if template.startswith("$"):
        return "a topic that begins with $ is one of the broker's own; begin with another character"
    if len(template.encode()) > MOST_BYTES:
        return f"it is longer than {MOST_BYTES} bytes; shorten it"
    for level in levels:
        if levels.count(level) > 1 and level.startswith("{"):
            return f"{level} stands there twice; remove one of them"
    for needed in _OF_A_VALUE:
        if needed not in levels:
            return f"two data sources would share a topic; add {needed} as a level"
    if "{site}" in levels and site is None:
        return "there is no site; write `site` too, or remove {site}"
    if "{site}" not in levels and site is not None:
        return "`site` has no place in it; add {site}, or remove `site`"
    return "" if site is None else _site_problem(site)


def _level_problem(level: str) -> str:
    if not level:
        return "it has an empty level; write levels with one / between them, and none at its ends"
    if any(character in "+#" for character in level):
        return "it has a wildcard (+ or #), which is for subscribers; name the level"
    if any(character <= " " or character == "\x7f" for character in level):
        return "it has a space or a control character; write - or _ in its place"
    if "{" not in level and "}" not in level:
        return ""
    match = _PLACEHOLDER.fullmatch(level)
    if match is None:
        return f"a placeholder is a whole level, and {level} has more in it; write / around it"
    if match[1] not in _PLACEHOLDERS:
        there = ", ".join(f"{{{name}}}" for name in _PLACEHOLDERS)
        return f"{level} is no placeholder; {closest(match[1], _PLACEHOLDERS) or f'there are: {there}'}"
    return ""


def _site_problem(site: str) -> str:
    problem = next((found for level in site.split("/") if (found := _level_problem(level))), "")
    if not problem and site.startswith("$"):
        problem = "it begins with $, as topics of the broker's own; begin with another character"
    if not problem and "{" in site:
        problem = "it has a placeholder; write the name itself"
    if not problem and len(site.encode()) > MOST_BYTES:
        problem = f"it is longer than {MOST_BYTES} bytes; shorten it"
    return problem and f"site {site!r}: {problem}"


class NamespaceTopics:
    """The topics of one fleet; the template was checked."""

    def __init__(self, template: str, site: str | None, fleet: str) -> None:
        levels = [{"{site}": site or "", "{fleet}": level_of(fleet)}.get(each, each) for each in template.split("/")]
        self._levels = levels
        first = min(levels.index(each) for each in _OF_A_VALUE)
        self.server = "/".join([*levels[:first], SERVER])
        """Where the server says that it is there, and the broker that it is not."""

    def topic(self, robot: str, data: str) -> str:
        """The topic of a value."""
        return "/".join([{"{robot}": robot, "{data}": data}.get(level, level) for level in self._levels])

    def of_field(self, robot: str, data_set: DataSetModel, field: FieldModel) -> str:
        """The same for a field of a data source."""
        return self.topic(robot, data_set.name if data_set.is_single else f"{data_set.name}.{field.name}")
