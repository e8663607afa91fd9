"""The fields of Actions by name: those that the metadata has, and those that every Action of ours has besides.

    request     ExecutionId (of a request to halt, suspend or resume: the execution), or the arguments of the skill
    response    ExecutionState and ExecutionMessage, then the results of the skill, which are there once it is done

In UADP the second kind stands at known places, and metadata leaves it out. A JSON payload has names and no places, so
`ua-action-metadata` lists the two fields of each response. A foreign responder needs not have them.
"""

from __future__ import annotations

from typing import Final

from ua_fleet.values import BuiltinType
from ua_fleet.wire.actions import ActionMessage
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement
from ua_fleet.wire.json import DataSetFields
from ua_fleet.wire.messages import DataSetMetaData, FieldMetaData

__all__ = ["ActionFields", "announced_over_json", "heard_over_json"]

EXECUTION: Final = FieldMetaData("ExecutionId", int(BuiltinType.BYTE_STRING))
REPORT: Final = (
    FieldMetaData("ExecutionState", int(BuiltinType.BYTE)),
    FieldMetaData("ExecutionMessage", int(BuiltinType.STRING)),
)
_EXECUTION_TYPES: Final = (int(BuiltinType.BYTE_STRING),)
_REPORT_TYPES: Final = tuple([field.builtin_type for field in REPORT])
_REPORT_NAMES: Final = tuple([field.name for field in REPORT])


def announced_over_json(action: ActionMetaDataAnnouncement) -> ActionMetaDataAnnouncement:
    """An announcement of ours, with all fields of its response."""
    return action._replace(response=_reporting(action.response))


def heard_over_json(action: ActionMetaDataAnnouncement) -> ActionMetaDataAnnouncement:
    """An announcement that was heard, with the fields of its response that UADP metadata has."""
    fields = action.response.fields
    if tuple([field.name for field in fields[: len(REPORT)]]) != _REPORT_NAMES:
        return action
    return action._replace(response=action.response._replace(fields=fields[len(REPORT) :]))


def _reporting(response: DataSetMetaData) -> DataSetMetaData:
    return response._replace(fields=(*REPORT, *response.fields))


class ActionFields:
    """How the payloads of one Action are written and read."""

    def __init__(self, action: ActionMetaDataAnnouncement) -> None:
        """Plan them; raises RemoteWireError where the metadata contradicts itself."""
        request, response = action.request, action.response
        self._arguments = DataSetFields(request)
        self._results = DataSetFields(response)
        self._control = DataSetFields(request._replace(fields=(EXECUTION,)))
        self._report = DataSetFields(response._replace(fields=REPORT))
        self.request = DataSetFields(request._replace(fields=(*request.fields, EXECUTION)))
        """By which a request is read."""
        self.response = DataSetFields(_reporting(response))
        """By which a response is read."""

    def to_write(self, message: ActionMessage) -> DataSetFields:
        """The fields that a message of ours has."""
        types, count = message.types, len(message.types)
        if message.is_request:
            is_control = types == _EXECUTION_TYPES and count != len(self._arguments.fields)
            return self._control if is_control else self._arguments
        if types[: len(REPORT)] != _REPORT_TYPES:
            return self._results
        return self._report if count == len(REPORT) else self.response

    def as_read(self, message: ActionMessage) -> ActionMessage:
        """A message that was read with `request` or `response`, with those of its fields that were there."""
        types, values = message.types, message.values
        if message.is_request:
            if not types:
                return message
            last = slice(-1, None) if types[-1] else slice(None, -1)
            return message._replace(types=types[last], values=values[last])
        first = 0 if any(types[: len(REPORT)]) else len(REPORT)
        end = len(types) if any(types[len(REPORT) :]) else len(REPORT)
        return message._replace(types=types[first:end], values=values[first:end])
