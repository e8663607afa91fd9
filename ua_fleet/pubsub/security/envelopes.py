"""The envelopes of one process, one for each of its connections, as one user of keys.

The keys of a group are the same for all connections. Each envelope has its own replay windows and its own blocks of
nonces, so that no nonce is used twice though a message goes over all of them. Each asks the others' windows, so that
nobody can carry a message from one connection to another.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.security.keyring import GroupKeys
from ua_fleet.wire.security import SecurityMode

__all__ = ["Envelopes"]


class Envelopes:
    """See the module."""

    def __init__(self, envelopes: Sequence[Envelope]) -> None:
        self._all = tuple(envelopes)
        for envelope in self._all if len(self._all) > 1 else ():
            envelope.know(self._all)

    def __iter__(self) -> Iterator[Envelope]:
        return iter(self._all)

    @property
    def problem(self) -> str:
        """Why something could not be sent; empty when the last message of each connection could."""
        return next((envelope.problem for envelope in self._all if envelope.problem), "")

    @property
    def is_secured(self) -> bool:
        """Whether there are keys to be had."""
        return any(envelope.mode is not SecurityMode.NONE for envelope in self._all)

    @property
    def are_encrypted(self) -> bool:
        """Whether nobody without keys reads what goes over any of the connections."""
        return all(envelope.mode is SecurityMode.SIGN_AND_ENCRYPT for envelope in self._all)

    @property
    def max_plain_bytes(self) -> int:
        """The longest plain message that goes as one datagram by each connection."""
        return min(envelope.max_plain_bytes for envelope in self._all)

    def groups_wanted(self) -> list[str]:
        """All groups that keys are needed of, our own data's first."""
        return list(dict.fromkeys(group_id for envelope in self._secured() for group_id in envelope.groups_wanted()))

    def keys_wanted(self, now: float) -> list[str]:
        """The groups whose keys are to be fetched now."""
        return list(dict.fromkeys(group_id for envelope in self._secured() for group_id in envelope.keys_wanted(now)))

    def keys_last_s(self, now: float) -> dict[str, float]:
        """For how many seconds the keys of each group are enough, where there are any."""
        lasts: dict[str, float] = {}
        for envelope in self._secured():
            for group_id, lasts_s in envelope.keys_last_s(now).items():
                lasts[group_id] = min(lasts_s, lasts.get(group_id, lasts_s))
        return lasts

    def install(self, group_id: str, keys: GroupKeys, now: float) -> None:
        """Take keys of a group, the current one first. Raises LocalWireError for keys of the wrong length."""
        for envelope in self._secured():
            if group_id in envelope.groups_wanted():
                envelope.install(group_id, keys, now)

    def _secured(self) -> list[Envelope]:
        return [envelope for envelope in self._all if envelope.mode is not SecurityMode.NONE]
