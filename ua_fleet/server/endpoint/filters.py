"""Filters of monitored items, checked when they are set, so that none can fail or run away at a later event."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateUsage=false

from __future__ import annotations

import logging
import math
import re
from typing import Any, Final

from asyncua import ua
from asyncua.server.address_space import AddressSpace
from asyncua.server.monitored_item_service import WhereClauseEvaluator

# The class that is decoded; `ua` has one derived from it under the same name.
from asyncua.ua.uaprotocol_auto import DataChangeFilter

from ua_fleet.server.endpoint.stack import DECODE_ERRORS, AttributeIds, ObjectIds, Refusal, StatusCodes, ns0

__all__ = ["EventFilter", "check_data_filter", "check_event_filter", "deadband_of", "filter_of"]

_log = logging.getLogger("ua_fleet.server.filters")

_OPERANDS: Final = (ua.ElementOperand, ua.LiteralOperand, ua.AttributeOperand, ua.SimpleAttributeOperand)
_COUNTS: Final = {
    ua.FilterOperator.Equals: 2,
    ua.FilterOperator.IsNull: 1,
    ua.FilterOperator.GreaterThan: 2,
    ua.FilterOperator.LessThan: 2,
    ua.FilterOperator.GreaterThanOrEqual: 2,
    ua.FilterOperator.LessThanOrEqual: 2,
    ua.FilterOperator.Like: 2,
    ua.FilterOperator.Not: 1,
    ua.FilterOperator.Between: 3,
    ua.FilterOperator.InList: 2,
    ua.FilterOperator.And: 2,
    ua.FilterOperator.Or: 2,
    ua.FilterOperator.OfType: 1,
}
"""The operators that are evaluated, with their least number of operands."""
_NUMBERS: Final = range(2, 12)
"""Built-in types SByte (2) to Double (11)."""


class _Evaluator(WhereClauseEvaluator):
    """asyncua's, with subtypes for OfType and with Like."""

    def _eval_el(self, index: int, event: Any) -> Any:
        element = self.elements[index]
        if element.FilterOperator == ua.FilterOperator.OfType:
            return self._is_subtype(event.EventType, self._eval_op(element.FilterOperands[0], event))
        return super()._eval_el(index, event)

    def eval_first(self, event: Any) -> Any:
        """The whole clause: its first element refers to the others."""
        return self._eval_el(0, event)

    def _is_subtype(self, event_type: Any, wanted: Any) -> bool:
        current = event_type
        for _ in range(50):
            if current == wanted:
                return True
            node = self._aspace.get(current)
            parents = (
                ref.NodeId
                for ref in (node.references if node is not None else ())
                if not ref.IsForward and ref.ReferenceTypeId == ns0(ObjectIds.HasSubtype)
            )
            current = next(parents, None)
            if current is None:
                return False
        return False

    def _like_operator(self, string: Any, pattern: Any) -> bool:
        """OPC 10000-4 7.7.3: `%` any characters, `_` one, `[]` one of, `[^]` none of; `backslash` one as it is."""
        if not isinstance(string, str) or not isinstance(pattern, str) or len(pattern) > 200 or len(string) > 10_000:
            return False
        return _like(string, re.findall(r"\\.|\[\^?[^\]]+\]|.", pattern, re.DOTALL))


def _like(text: str, tokens: list[str]) -> bool:
    """Match with a way back to the last `%` alone, so that no pattern takes longer than text times pattern."""
    at = position = 0
    anchor, tried = -1, 0
    while at < len(text):
        if position < len(tokens) and tokens[position] == "%":
            anchor, tried = position, at
            position += 1
        elif position < len(tokens) and _fits(tokens[position], text[at]):
            at, position = at + 1, position + 1
        elif anchor >= 0:
            tried += 1
            at, position = tried, anchor + 1
        else:
            return False
    return set(tokens[position:]) <= {"%"}


def _fits(token: str, character: str) -> bool:
    if token in {"_"}:
        return True
    if len(token) > 2 and token[0] == "[":
        inside, other = (token[2:-1], True) if token[1] == "^" else (token[1:-1], False)
        ranges = re.findall(r"(.)-(.)|(.)", inside, re.DOTALL)
        return other != any(low <= character <= high if low else character == one for low, high, one in ranges)
    return character == (token[1] if token[0] == "\\" and len(token) == 2 else token)


class EventFilter:
    """Which events an item tells of, and which of their fields."""

    def __init__(self, aspace: AddressSpace, wanted: ua.EventFilter) -> None:
        self.select = wanted.SelectClauses
        self._where = _Evaluator(_log, aspace, wanted.WhereClause)

    def passes(self, event: Any) -> bool:
        """Whether the event is told; one that the filter cannot be applied to is not."""
        if not self._where.elements:
            return True
        try:
            return bool(self._where.eval_first(event))
        except DECODE_ERRORS:
            return False


def filter_of(parameters: ua.MonitoringParameters) -> Any:
    """The filter of an item; an ExtensionObject without a type is none."""
    wanted = parameters.Filter
    return None if isinstance(wanted, ua.ExtensionObject) and wanted.TypeId.is_null() else wanted


def check_event_filter(aspace: AddressSpace, wanted: Any, limit: int) -> EventFilter:
    """The filter of an event item; raises Refusal for one that cannot be evaluated."""
    if not isinstance(wanted, ua.EventFilter):
        raise Refusal(StatusCodes.BadMonitoredItemFilterInvalid, "an event item needs an EventFilter")
    elements = wanted.WhereClause.Elements or []
    if len(elements) > limit or len(wanted.SelectClauses or []) > limit:
        raise Refusal(StatusCodes.BadMonitoredItemFilterInvalid, f"a filter of more than {limit} elements")
    for index, element in enumerate(elements):
        operands = element.FilterOperands or []
        least = _COUNTS.get(element.FilterOperator)
        if least is None:
            raise Refusal(StatusCodes.BadMonitoredItemFilterUnsupported, f"operator {element.FilterOperator}")
        if not least <= len(operands) <= limit:
            raise Refusal(StatusCodes.BadMonitoredItemFilterInvalid, "a wrong number of operands")
        for operand in operands:
            if not isinstance(operand, _OPERANDS):
                raise Refusal(StatusCodes.BadMonitoredItemFilterInvalid, "an unknown operand")
            # Elements refer to later ones only, so that no filter refers to itself (OPC 10000-4 7.7.4.2).
            if isinstance(operand, ua.ElementOperand) and not index < operand.Index < len(elements):
                raise Refusal(StatusCodes.BadMonitoredItemFilterInvalid, "an element that refers backwards")
    _check_size(elements)
    return EventFilter(aspace, wanted)


def _check_size(elements: list[Any]) -> None:
    """Refuse a filter whose evaluation takes more steps than it has elements many times over."""
    costs = [1] * len(elements)
    for index in range(len(elements) - 1, -1, -1):
        for operand in elements[index].FilterOperands or []:
            if isinstance(operand, ua.ElementOperand):
                costs[index] += costs[operand.Index]
    if costs and costs[0] > 1_000:
        raise Refusal(StatusCodes.BadMonitoredItemFilterInvalid, "a filter that refers to its elements too often")


def check_data_filter(wanted: Any, *, attribute: int, value: ua.DataValue) -> None:
    """Raise Refusal for a filter that a data item of this attribute cannot have."""
    if wanted is None:
        return
    if not isinstance(wanted, DataChangeFilter):
        raise Refusal(StatusCodes.BadMonitoredItemFilterInvalid, "a data item takes a DataChangeFilter")
    if attribute != AttributeIds.Value:
        raise Refusal(StatusCodes.BadFilterNotAllowed, "a filter on another attribute than Value")
    try:
        trigger = ua.DataChangeTrigger(wanted.Trigger)
        kind = ua.DeadbandType(wanted.DeadbandType)
    except ValueError as error:
        raise Refusal(StatusCodes.BadMonitoredItemFilterInvalid, str(error)) from error
    if kind == ua.DeadbandType.Percent:
        raise Refusal(StatusCodes.BadMonitoredItemFilterUnsupported, "a deadband in percent")
    if kind == ua.DeadbandType.Absolute:
        if not (math.isfinite(wanted.DeadbandValue) and wanted.DeadbandValue >= 0):
            raise Refusal(StatusCodes.BadDeadbandFilterInvalid, f"deadband {wanted.DeadbandValue}")
        known = value.Value is not None and value.Value.Value is not None
        if known and value.Value is not None and value.Value.VariantType.value not in _NUMBERS:
            raise Refusal(StatusCodes.BadFilterNotAllowed, f"a deadband on a {value.Value.VariantType.name}")
    del trigger


def deadband_of(wanted: Any) -> float:
    """The absolute deadband of a checked filter, 0 without one."""
    return float(wanted.DeadbandValue) if wanted.DeadbandType == ua.DeadbandType.Absolute else 0.0
