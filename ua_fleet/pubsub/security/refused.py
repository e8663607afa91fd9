"""A message that was not let in, and what its operator can do about it."""

from __future__ import annotations

from typing import Final

from ua_fleet.counters import Drop
from ua_fleet.errors import RemoteWireError
from ua_fleet.wire.security import SecuredDatagram, SecurityMode

__all__ = ["DatagramRefused"]

_MODES: Final = {SecurityMode.SIGN: "signed", SecurityMode.SIGN_AND_ENCRYPT: "signed and encrypted"}


class DatagramRefused(RemoteWireError):
    """A datagram that was dropped for its security. Nothing that its headers say is proved."""

    def __init__(
        self, drop: Drop, heard: SecuredDatagram, mode: SecurityMode = SecurityMode.NONE, group_id: str = ""
    ) -> None:
        self.drop = drop
        self.publisher_id = heard.publisher_id
        self.writer_group_id = heard.writer_group_id
        self.writer_ids = heard.writer_ids
        self.is_action = heard.is_action
        super().__init__(drop.value, _detail(drop, heard, mode, group_id))


def _detail(drop: Drop, heard: SecuredDatagram, mode: SecurityMode, group_id: str) -> str:
    sender = f"PublisherId {str(heard.publisher_id)[:64]}"
    token = f"token {heard.token_id} of {group_id}"
    if drop is Drop.NOT_SECURED:
        return f"{sender} sends what is not {_MODES[mode]}; give it the same `pubsub.security` as this process"
    if drop is Drop.BAD_SIGNATURE:
        return f"{sender}, {token}: not signed with our key; give both their keys from the same service or files"
    if drop is Drop.UNKNOWN_TOKEN and not group_id:
        return f"{sender} is no publisher of fleet.yaml, so nobody is asked for its keys; make it a bridge there"
    if drop is Drop.UNKNOWN_TOKEN:
        return f"{sender}, {token}: no such key here; it is requested; check that the key source has it"
    if drop is Drop.REPLAYED:
        return (
            f"{sender}, {token}: nonce used before, too old or missing; give a bridge its state_dir back or new keys, "
            "put a foreign publisher into `pubsub.relaxed_replay`"
        )
    if drop is Drop.UNKNOWN_SOURCE:
        return f"{sender} is no space (a UInt16), and only those have SecurityGroups"
    return sender
