"""What is kept of the values of each node, by `fleet.yaml`."""

from __future__ import annotations

from ua_fleet.config.history_schema import EventHistoryConfig, HistoryConfig, ValueHistoryConfig
from ua_fleet.config.parts import Parts
from ua_fleet.config.schema import FleetConfig
from ua_fleet.document import KeyPath
from ua_fleet.fleet.model import FieldModel, RobotModel
from ua_fleet.history.events import AUDIT_EVENTS, EVENTS
from ua_fleet.history.rules import Rule
from ua_fleet.values import BuiltinType, NodeId

__all__ = ["HistoryRules", "check_history", "is_stepped", "rule_of"]

_KEYS = ("deadband", "at_most_each_s", "at_least_each_s", "days")


class HistoryRules:
    """The rules of all nodes of a server, of robots that come later too."""

    def __init__(self, config: FleetConfig) -> None:
        """Take those of a configuration."""
        self._config = config
        self._rules: dict[NodeId, tuple[Rule, bool]] = {}
        """By node, and whether it is stepped."""

    def add(self, robot: RobotModel) -> None:
        """Know the data of a robot. Of one that stands in no file all is kept as of the fleet."""
        config = self._config.robots.get(robot.name)
        for data_set in robot.data_sets:
            data = None if config is None else config.data.get(data_set.name)
            levels = (None if config is None else config.history, None if data is None else data.history)
            rule = rule_of(self._config.history, *levels)
            if rule is not None:
                self._rules |= {field.key: (rule, is_stepped(field)) for field in data_set.fields}

    def remove(self, robot: RobotModel) -> None:
        """Forget it."""
        for data_set in robot.data_sets:
            for field in data_set.fields:
                self._rules.pop(field.key, None)

    def of(self, key: NodeId) -> Rule | None:
        """What is kept of a node; None where nothing is."""
        found = self._rules.get(key)
        return None if found is None else found[0]

    def is_stepped(self, key: NodeId) -> bool | None:
        """Whether a node's value holds until the next one; None for a node without a history."""
        found = self._rules.get(key)
        return None if found is None else found[1]

    @property
    def events(self) -> EventHistoryConfig | None:
        """What is kept of events; None where nothing is."""
        history = self._config.history
        if history is None or history.events is False:
            return None
        return EventHistoryConfig() if history.events is True else history.events

    def days_of(self, key: NodeId) -> float:
        """For how long the rows of a node, or events, are kept, also of one that is not recorded any more."""
        if (rule := self.of(key)) is not None:
            return rule.days
        events = self.events
        if key in (EVENTS, AUDIT_EVENTS) and events is not None and events.days is not None:
            return events.days
        return HistoryConfig().days if self._config.history is None else self._config.history.days


def rule_of(top: HistoryConfig | None, *levels: ValueHistoryConfig | bool | None) -> Rule | None:
    """What is kept where the fleet, a robot and a data source say this; None for nothing."""
    if top is None:
        return None
    kept = {key: getattr(top, key) for key in _KEYS}
    is_recorded = top.record
    for level in levels:
        if isinstance(level, bool):
            is_recorded = level
        elif level is not None:
            is_recorded = True
            kept |= {key: value for key in _KEYS if (value := getattr(level, key)) is not None}
    return Rule(**kept) if is_recorded else None


def is_stepped(field: FieldModel) -> bool:
    """Whether a value holds until the next one; between numbers with fractions a line is drawn."""
    return field.type not in (BuiltinType.FLOAT, BuiltinType.DOUBLE)


def check_history(parts: Parts, top: HistoryConfig | None) -> None:
    """Note keys that have no effect, since nothing is kept at all."""
    if top is not None:
        return
    found: list[KeyPath] = [("robots", name, "history") for name, robot in parts.robots.items() if robot.history]
    found += [("robots", robot, "data", name, "history") for (robot, name), each in parts.data.items() if each.history]
    text = "the fleet keeps no history: `history` is missing at the top of the file"
    for path in found:
        parts.document.problem(path, text, "add `history: {record: false}` there; then these values alone are kept")
