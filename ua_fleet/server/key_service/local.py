"""The server's own hub as a reader of keys: no connection, no certificate, the same rules."""

from __future__ import annotations

import asyncio
import math

from ua_fleet.errors import KeySourceUnavailable, KeysRefused, UaFleetError
from ua_fleet.pubsub.security.keyring import GroupKeys
from ua_fleet.server.key_service.pushed import KeysNotPushed
from ua_fleet.server.key_service.service import KeysDenied, KeyService
from ua_fleet.server.key_service.store import GroupUnknown
from ua_fleet.topics import SERVER_SPACE

__all__ = ["LocalKeySource"]


class LocalKeySource:
    """A KeySource over the key service of the same process."""

    def __init__(self, service: KeyService, space: int = SERVER_SPACE) -> None:
        self._service, self._space = service, space

    @property
    def refresh_s(self) -> float:
        """See KeySource: half of the KeyLifetime is often enough."""
        return math.inf

    @property
    def generation(self) -> int:
        """See KeySource."""
        return self._service.changes

    async def fetch(self, group_id: str, starting_token_id: int, count: int) -> GroupKeys:
        """See KeySource; new keys go to the disk first, which is waited for in a thread."""
        keys = self._service.keys_for_space
        try:
            return await asyncio.to_thread(keys, self._space, group_id, starting_token_id, count)
        except (GroupUnknown, KeysDenied, KeysNotPushed) as error:
            raise KeysRefused(group_id, str(error)) from error
        except UaFleetError as error:
            raise KeySourceUnavailable(str(error)) from error
