"""Filters of monitored items, checked when they are set, so that none can fail or run away at a later event."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateUsage=false

from __future__ import annotations

import functools
import logging
import math
import re
from typing import Any, Final

from asyncua import ua
from asyncua.server.address_space import AddressSpace
from asyncua.server.monitored_item_service import WhereClauseEvaluator
from asyncua.ua.ua_binary import variant_to_binary

# The class that is decoded; `ua` has one derived from it under the same name.
from asyncua.ua.uaprotocol_auto import DataChangeFilter

from ua_fleet.endpoint.event_fields import EventFields, field_of
from ua_fleet.endpoint.stack import DECODE_ERRORS, AttributeIds, ObjectIds, Refusal, StatusCodes, ns0, status

__all__ = ["EventFilter", "FilterRefused", "check_data_filter", "check_event_filter", "filter_of"]

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
_HAS_PROPERTY: Final = ns0(ObjectIds.HasProperty)
_EU_RANGE: Final = ua.QualifiedName("EURange", ua.UInt16(0))
_NUMBERS: Final = range(2, 12)
"""Built-in types SByte (2) to Double (11)."""
_LONGEST_PATTERN: Final = 200
_LONGEST_TEXT: Final = 1_000
"""Characters of a pattern, and of a text that is held against one."""
_COSTLIEST: Final = 1_000
"""Steps of one filter for one event."""
_STEP_BYTES: Final = 64
"""Bytes of a literal that take as long to compare as one operand to find."""
_OF_TYPE: Final = 10
"""Steps of a way up to a type."""


class _Evaluator(WhereClauseEvaluator):
    """asyncua's, with whole BrowsePaths and nulls as OPC 10000-4 7.7.3 has them, subtypes for OfType, and Like."""

    def __init__(self, logger: logging.Logger, aspace: AddressSpace, where: ua.ContentFilter) -> None:
        super().__init__(logger, aspace, where)
        operands = [operand for element in self.elements or () for operand in element.FilterOperands or ()]
        self._fields = {id(one): field_of(one) for one in operands if isinstance(one, ua.SimpleAttributeOperand)}
        """The fields of events that are compared, by the operands that name them."""

    def _eval_el(self, index: int, event: Any) -> Any:
        """What an element is: True, False, or None for what follows from neither."""
        element = self.elements[index]
        operator, operands = element.FilterOperator, element.FilterOperands
        if operator == ua.FilterOperator.OfType:
            return self._is_subtype(event.EventType, self._eval_op(operands[0], event))
        if operator == ua.FilterOperator.Not:
            known = _truth(self._eval_op(operands[0], event))
            return None if known is None else not known
        if operator in (ua.FilterOperator.And, ua.FilterOperator.Or):
            decides = operator == ua.FilterOperator.Or
            if (one := _truth(self._eval_op(operands[0], event))) is decides:
                return decides
            other = _truth(self._eval_op(operands[1], event))
            return other if other is decides or one is not None else None
        try:
            return super()._eval_el(index, event)
        except TypeError:
            return False  # values that cannot be compared

    def _eval_op(self, op: Any, event: Any) -> Any:
        field = self._fields.get(id(op))
        return super()._eval_op(op, event) if field is None else field.of(event).Value

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
        if not isinstance(string, str) or not isinstance(pattern, str) or len(string) > _LONGEST_TEXT:
            return False
        return _like(string, pattern)


def _truth(value: Any) -> bool | None:
    """A Boolean; None for what is none."""
    return value if isinstance(value, bool) else None


def _like(text: str, pattern: str) -> bool:
    """OPC 10000-4 7.7.3: `%` any characters, `_` one, `[]` one of, `[^]` none of; a backslash takes the next as it is.

    What stands between two `%` has one length, so that the first place where it fits is right, and no pattern takes
    longer than text times pattern.
    """
    parts = _parts(pattern)
    at = 0
    for number, (part, length) in enumerate(parts):
        if number == len(parts) - 1:  # the end of the text
            at = max(at, len(text) - length) if number else 0
            return part.fullmatch(text, at) is not None
        found = part.search(text, at) if number else part.match(text)
        if found is None:
            return False
        at = found.end()
    return False


@functools.lru_cache(256)
def _parts(pattern: str) -> list[tuple[re.Pattern[str], int]]:
    """What stands between the `%` of a pattern, and how many characters each takes."""
    parts: list[list[str]] = [[]]
    for sign in re.findall(r"\\.|\[\^?[^\]]+\]|.", pattern, re.DOTALL):
        if sign == "%":
            parts.append([])
        else:
            parts[-1].append(_expression(sign))
    return [(re.compile("".join(part), re.DOTALL), len(part)) for part in parts]


def _expression(sign: str) -> str:
    if sign == "_":
        return "."
    if len(sign) > 2 and sign[0] == "[":
        inside, other = (sign[2:-1], True) if sign[1] == "^" else (sign[1:-1], False)
        ranges = re.findall(r"(.)-(.)|(.)", inside, re.DOTALL)
        # A range that goes backwards holds nothing.
        found = [re.escape(low) + "-" + re.escape(high) for low, high, _ in ranges if low and low <= high]
        found += [re.escape(one) for _, _, one in ranges if one]
        if not found:
            return "." if other else "(?!).?"
        return f"[{'^' if other else ''}{''.join(found)}]"
    return re.escape(sign[1] if sign[0] == "\\" and len(sign) == 2 else sign)


class EventFilter:
    """Which events an item tells of, and which of their fields."""

    def __init__(self, aspace: AddressSpace, wanted: ua.EventFilter, result: ua.EventFilterResult | None) -> None:
        self.select = [field_of(clause) for clause in wanted.SelectClauses or []]
        self.result = result
        """What the client is told of it; None where it gave none."""
        self.cost = _cost_of(wanted)
        """Steps that one event takes."""
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


class FilterRefused(Refusal):
    """An EventFilter that cannot be taken; `result` says which of its parts is wrong."""

    def __init__(self, code: int, reason: str, result: ua.EventFilterResult) -> None:
        self.result = result
        super().__init__(code, reason)


def check_event_filter(aspace: AddressSpace, wanted: Any, limit: int, declared: EventFields) -> EventFilter:
    """The filter of an event item; raises Refusal for one that cannot be evaluated.

    Args:
        aspace: the server's nodes.
        wanted: an EventFilter, or None for all events and none of their fields.
        limit: elements that each clause may have.
        declared: the fields that there are.
    """
    if wanted is None:
        return EventFilter(aspace, ua.EventFilter(), None)
    if not isinstance(wanted, ua.EventFilter):
        raise Refusal(StatusCodes.BadFilterNotAllowed, "an event item takes an EventFilter")
    elements = wanted.WhereClause.Elements or []
    if len(elements) > limit or len(wanted.SelectClauses or []) > limit:
        raise Refusal(StatusCodes.BadEventFilterInvalid, f"a filter of more than {limit} elements")
    if any(len(element.FilterOperands or []) > limit for element in elements):
        raise Refusal(StatusCodes.BadEventFilterInvalid, f"an element of more than {limit} operands")
    result: Any = ua.EventFilterResult()
    result.SelectClauseResults = declared.check_all(wanted.SelectClauses or [])
    for index, element in enumerate(elements):
        result.WhereClauseResult.ElementResults.append(_element_result(element, index, len(elements)))
    for found in result.WhereClauseResult.ElementResults:
        code = int(found.StatusCode.value)
        if code == StatusCodes.BadFilterOperatorUnsupported:
            raise FilterRefused(StatusCodes.BadMonitoredItemFilterUnsupported, found.StatusCode.name, result)
        if code:
            raise FilterRefused(StatusCodes.BadMonitoredItemFilterInvalid, found.StatusCode.name, result)
    made = EventFilter(aspace, wanted, result)
    if made.cost > _COSTLIEST:
        raise Refusal(StatusCodes.BadMonitoredItemFilterInvalid, f"a filter of {made.cost} steps for each event")
    return made


def _element_result(element: ua.ContentFilterElement, index: int, count: int) -> Any:
    """Whether an element of a where clause can be evaluated, and which of its operands cannot (OPC 10000-4 7.7.2)."""
    result: Any = ua.ContentFilterElementResult()
    operands = element.FilterOperands or []
    least = _COUNTS.get(element.FilterOperator)
    if least is None:
        result.StatusCode = status(StatusCodes.BadFilterOperatorUnsupported)
        return result
    most = len(operands) if element.FilterOperator == ua.FilterOperator.InList else least
    if not least <= len(operands) <= most:
        result.StatusCode = status(StatusCodes.BadFilterOperandCountMismatch)
        return result
    codes = [_operand_code(operand, index, count) for operand in operands]
    if element.FilterOperator == ua.FilterOperator.Like and not _is_pattern(_literal(operands[1])):
        codes[1] = int(StatusCodes.BadFilterLiteralInvalid)
    if any(codes):
        result.StatusCode = status(next(filter(None, codes)))
        result.OperandStatusCodes = [status(code) for code in codes]
    return result


def _operand_code(operand: Any, index: int, count: int) -> int:
    if not isinstance(operand, _OPERANDS):
        return int(StatusCodes.BadFilterOperandInvalid)
    # Elements refer to later ones only, so that no filter refers to itself (OPC 10000-4 7.7.1).
    if isinstance(operand, ua.ElementOperand) and not index < operand.Index < count:
        return int(StatusCodes.BadFilterElementInvalid)
    return 0


def _is_pattern(literal: Any) -> bool:
    """Whether a Like has a pattern that is known now, and is short."""
    return isinstance(literal, str) and len(literal) <= _LONGEST_PATTERN


def _literal(operand: Any) -> Any:
    value = operand.Value if isinstance(operand, ua.LiteralOperand) else None
    return value.Value if value is not None else None


def _cost_of(wanted: ua.EventFilter) -> int:
    """Steps that an event takes at most: of its where clause, and of the fields that are told."""
    elements = wanted.WhereClause.Elements or []
    costs = [0] * len(elements)
    for index in range(len(elements) - 1, -1, -1):
        element = elements[index]
        cost = _OF_TYPE if element.FilterOperator == ua.FilterOperator.OfType else 1
        if element.FilterOperator == ua.FilterOperator.Like:
            cost += len(_literal(element.FilterOperands[1]))
        for operand in element.FilterOperands or []:
            if isinstance(operand, ua.ElementOperand):
                cost += costs[operand.Index]
            elif isinstance(operand, ua.LiteralOperand) and operand.Value is not None:
                cost += 1 + _size_of(operand.Value) // _STEP_BYTES
            else:
                cost += 1
        costs[index] = cost
    return len(wanted.SelectClauses or []) + (costs[0] if costs else 0)


def _size_of(literal: ua.Variant) -> int:
    try:
        return len(variant_to_binary(literal))
    except DECODE_ERRORS as error:
        raise Refusal(StatusCodes.BadFilterLiteralInvalid, str(error)) from error


def check_data_filter(
    aspace: AddressSpace, wanted: Any, *, node_id: ua.NodeId, attribute: int, value: ua.DataValue
) -> float:
    """The deadband of a data item's filter, in the units of the value; 0 without one.

    Raises Refusal for a filter that an item of this attribute cannot have.
    """
    if wanted is None:
        return 0.0
    if attribute != AttributeIds.Value or isinstance(wanted, ua.EventFilter):
        raise Refusal(StatusCodes.BadFilterNotAllowed, "this filter does not go with this attribute")
    if not isinstance(wanted, DataChangeFilter):
        raise Refusal(StatusCodes.BadMonitoredItemFilterUnsupported, "a data item takes a DataChangeFilter")
    try:
        ua.DataChangeTrigger(wanted.Trigger)
    except ValueError as error:
        raise Refusal(StatusCodes.BadMonitoredItemFilterInvalid, str(error)) from error
    try:
        kind = ua.DeadbandType(wanted.DeadbandType)
    except ValueError as error:
        raise Refusal(StatusCodes.BadDeadbandFilterInvalid, str(error)) from error
    if kind == ua.DeadbandType.None_:
        return 0.0
    known = value.Value is not None and value.Value.Value is not None
    if known and value.Value is not None and value.Value.VariantType.value not in _NUMBERS:
        raise Refusal(StatusCodes.BadFilterNotAllowed, f"a deadband on a {value.Value.VariantType.name}")
    most = 100.0 if kind == ua.DeadbandType.Percent else math.inf
    if not (math.isfinite(wanted.DeadbandValue) and 0 <= wanted.DeadbandValue <= most):
        raise Refusal(StatusCodes.BadDeadbandFilterInvalid, f"deadband {wanted.DeadbandValue}")
    if kind == ua.DeadbandType.Percent:
        return float(wanted.DeadbandValue) / 100 * _span_of(aspace, node_id)
    return float(wanted.DeadbandValue)


def _span_of(aspace: AddressSpace, node_id: ua.NodeId) -> float:
    """From the lower to the upper end of a node's EURange (OPC 10000-8 7.2); raises Refusal for one that has none."""
    node = aspace.get(node_id)
    for reference in node.references if node is not None else ():
        if reference.IsForward and reference.ReferenceTypeId == _HAS_PROPERTY and reference.BrowseName == _EU_RANGE:
            variant = aspace.read_attribute_value(reference.NodeId, AttributeIds.Value).Value
            found: Any = variant.Value if variant is not None else None
            if isinstance(found, ua.Range) and math.isfinite(found.High - found.Low) and found.High >= found.Low:
                return float(found.High - found.Low)
    raise Refusal(StatusCodes.BadDeadbandFilterInvalid, "a deadband in percent on a node without EURange")
