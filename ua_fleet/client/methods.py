# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""Calls of the fleet's own Methods, which all end with ReturnStatus and Message."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from asyncua import ua

from ua_fleet.errors import UaFleetError
from ua_fleet.values import StatusCode

if TYPE_CHECKING:
    from ua_fleet.client.fleet_client import FleetClient

__all__ = ["NotDone", "Returned", "call_method", "text", "texts"]

_STATUS: Final = {
    1: StatusCode.BAD_NODE_ID_UNKNOWN,
    2: StatusCode.BAD_CONFIGURATION_ERROR,
    3: StatusCode.BAD_INVALID_STATE,
    4: StatusCode.BAD_RESOURCE_UNAVAILABLE,
}
"""ReturnStatus of the server's Methods."""


class NotDone(UaFleetError):
    """The server has not done what was asked for; the text says why."""

    remedy = "Do what the server's text says."

    def __init__(self, return_status: int, message: str) -> None:
        self.return_status = return_status
        self.ua_status = int(_STATUS.get(return_status, StatusCode.BAD_UNEXPECTED_ERROR))
        super().__init__(message)


@dataclass(frozen=True, slots=True)
class Returned:
    """What a Method has returned."""

    outputs: list[Any]
    status: int
    message: str

    def check(self) -> list[Any]:
        """The outputs; raises NotDone where it was not done."""
        if self.status:
            raise NotDone(self.status, self.message)
        return self.outputs


async def call_method(client: FleetClient, owner: str, name: str, *arguments: ua.Variant) -> Returned:
    """Call a Method of the Object with the string id `owner`; raises what FleetClient.call does."""
    *outputs, status, message = await client.call(f"ns=2;s={owner}", f"ns=2;s={owner}.{name}", *arguments)
    return Returned(outputs, int(status), str(message))


def text(value: str) -> ua.Variant:
    """A text as an argument."""
    return ua.Variant(value, ua.VariantType.String)


def texts(values: Sequence[str]) -> ua.Variant:
    """Texts as an argument."""
    return ua.Variant(list(values), ua.VariantType.String, None, True)
