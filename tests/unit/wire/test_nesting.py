"""Values in values are followed as deep as DEEPEST_NESTING, wherever they stand and whatever was read before."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import BuiltinType as B
from ua_fleet.values import DiagnosticInfo
from ua_fleet.wire import ActionMessage, ActionState, Cause, Codec, encode_action
from ua_fleet.wire.cursor import DEEPEST_NESTING
from ua_fleet.wire.generic import encode_message
from ua_fleet.wire.messages import DataSetMessage, NetworkMessage

EMPTY = bytes((B.DIAGNOSTIC_INFO, 0))
"""A Variant of a DiagnosticInfo without members."""


def data() -> bytes:
    message = DataSetMessage(9, types=(B.DOUBLE, B.DIAGNOSTIC_INFO), values=(1.5, DiagnosticInfo()), sequence_number=1)
    return encode_message(NetworkMessage(2, writer_group_id=2, messages=(message,)))


def action(*, is_request: bool) -> bytes:
    message = ActionMessage(
        2,
        2,
        9,
        1,
        1,
        ActionState.EXECUTING if is_request else ActionState.DONE,
        is_request=is_request,
        requestor_id="0.server",
        correlation_data=bytes(16),
        types=(B.DIAGNOSTIC_INFO,),
        values=(DiagnosticInfo(),),
    )
    return encode_action(message)


MAKERS: dict[str, Callable[[], bytes]] = {
    "data": data,
    "a request": lambda: action(is_request=True),
    "a response": lambda: action(is_request=False),
}


@pytest.mark.parametrize("name", MAKERS)
def test_a_diagnostic_info_is_followed_so_deep_and_no_deeper(name: str) -> None:
    plain = MAKERS[name]()
    assert plain.endswith(EMPTY)
    codec = Codec()
    for _ in range(3):  # from the third time on a plan reads data
        codec.decode(plain)

    def nested(levels: int) -> bytes:
        return plain[:-1] + b"\x40" * levels + b"\0"

    codec.decode(nested(DEEPEST_NESTING))
    for levels in (DEEPEST_NESTING + 1, 1_000, 50_000):
        for reader in (codec, Codec()):
            with pytest.raises(RemoteWireError) as caught:
                reader.decode(nested(levels))
            assert caught.value.cause == Cause.TOO_DEEP


def test_none_is_written_that_nobody_reads() -> None:
    value = DiagnosticInfo()
    for _ in range(5_000):
        value = DiagnosticInfo(inner=value)
    message = DataSetMessage(9, types=(B.DIAGNOSTIC_INFO,), values=(value,), sequence_number=1)
    network_message = NetworkMessage(2, writer_group_id=2, messages=(message,))
    codec = Codec()
    for _ in range(3):
        with pytest.raises(LocalWireError):
            codec.encode(network_message)
