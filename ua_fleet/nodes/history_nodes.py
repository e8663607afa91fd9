"""What the address space says of history: how values are kept, and what HistoryRead can do (OPC 10000-11 5.2 to 5.5).

Fleet/History                 one HistoricalDataConfiguration for each way in which values are kept
  HA Configuration
a Variable with a history --HasHistoricalConfiguration--> its own
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from typing import Final

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from ua_fleet.config.history import HistoryRules
from ua_fleet.endpoint.convert import node_id, raw_id
from ua_fleet.endpoint.history_source import MOST_RETURNED
from ua_fleet.endpoint.node_builder import HAS_COMPONENT, ORGANIZES
from ua_fleet.endpoint.stack import ObjectIds, ns0
from ua_fleet.endpoint.standard_model import set_value
from ua_fleet.fleet.model import RobotModel
from ua_fleet.history.aggregates import Aggregate
from ua_fleet.history.bounds import Settings
from ua_fleet.history.rules import Rule
from ua_fleet.nodes.declared_nodes import DeclaredNodes
from ua_fleet.nodes.event_history_nodes import show_event_history
from ua_fleet.nodes.node_factory import STANDARD, NodeFactory
from ua_fleet.operation.pubsub.description import Description
from ua_fleet.values import QualifiedName

__all__ = ["HistoryNodes"]

_FOLDER: Final = "Fleet.History"
_HAS_CONFIGURATION: Final = raw_id(ObjectIds.HasHistoricalConfiguration)
_CONFIGURATION_TYPE: Final = raw_id(ObjectIds.HistoricalDataConfigurationType)
_DAY_MS: Final = 86_400_000.0


class HistoryNodes:
    """Makes these nodes."""

    def __init__(self, space: AddressSpace, parts: NodeFactory, rules: HistoryRules) -> None:
        """Prepare to make them for nodes of a fleet."""
        self._space, self._parts, self._rules = space, parts, rules
        self._declared = DeclaredNodes(space, parts.builder, parts.ns)
        self._made: dict[tuple[Rule, bool], ua.NodeId] = {}

    def build(self, fleet: ua.NodeId) -> None:
        """Say that there is a history."""
        builder = self._parts.builder
        name = QualifiedName(self._parts.ns, "History")
        builder.add_object(self._parts.id(_FOLDER), name, fleet, STANDARD["FolderType"], reference=ORGANIZES)
        capabilities = "HistoryServerCapabilities_"
        for name_of_value, value, kind in (
            ("AccessHistoryDataCapability", True, ua.VariantType.Boolean),
            ("MaxReturnDataValues", MOST_RETURNED, ua.VariantType.UInt32),
        ):
            set_value(self._space, ns0(getattr(ObjectIds, capabilities + name_of_value)), value, kind)
        if (events := self._rules.events) is not None:
            show_event_history(self._space, self._parts, audit=events.audit)
        for folder in ("HistoryServerCapabilities", "Server_ServerCapabilities"):
            functions = ns0(getattr(ObjectIds, f"{folder}_AggregateFunctions"))
            for aggregate in Aggregate:
                builder.add_reference(functions, ORGANIZES, ns0(aggregate))

    def knows(self, robot: RobotModel) -> None:
        """Know the data of a robot whose nodes are to be made."""
        self._rules.add(robot)

    def add(self, robot: RobotModel) -> None:
        """Have the Variables of a robot, whose nodes are made, say how their values are kept."""
        for data_set in robot.data_sets:
            for field in data_set.fields:
                rule, stepped = self._rules.of(field.key), self._rules.is_stepped(field.key)
                if rule is not None and stepped is not None:
                    configuration = self._configuration(rule, stepped)
                    self._parts.builder.add_reference(node_id(field.key), _HAS_CONFIGURATION, configuration)

    def remove(self, robot: RobotModel) -> None:
        """Forget a robot whose nodes are gone."""
        self._rules.remove(robot)

    def _configuration(self, rule: Rule, stepped: bool) -> ua.NodeId:
        made = self._made.get((rule, stepped))
        if made is None:
            path = f"{_FOLDER}.{len(self._made) + 1}"
            made = self._made[rule, stepped] = self._parts.id(path)
            self._parts.builder.add_object(
                made,
                QualifiedName(0, "HA Configuration"),
                self._parts.id(_FOLDER),
                _CONFIGURATION_TYPE,
                reference=HAS_COMPONENT,
            )
            self._declared.add_members(path, Description("HistoricalDataConfigurationType", _values(rule, stepped)))
        return made


def _values(rule: Rule, stepped: bool) -> dict[str, object]:
    """The members of a HistoricalDataConfiguration (OPC 10000-11 5.2.2)."""
    settings = Settings()
    return {
        "Stepped": stepped,
        "MinTimeInterval": rule.at_most_each_s * 1000,
        "MaxTimeInterval": rule.at_least_each_s * 1000,
        "ExceptionDeviation": rule.deadband,
        "ExceptionDeviationFormat": int(ua.ExceptionDeviationFormat.AbsoluteValue),
        "MaxTimeStoredValues": rule.days * _DAY_MS,
        "ServerTimestampSupported": False,
        "AggregateConfiguration.TreatUncertainAsBad": settings.treat_uncertain_as_bad,
        "AggregateConfiguration.PercentDataBad": settings.percent_data_bad,
        "AggregateConfiguration.PercentDataGood": settings.percent_data_good,
        "AggregateConfiguration.UseSlopedExtrapolation": settings.sloped_extrapolation,
    }
