"""A client whose own folder cannot be written: the server is not blamed, and its exit code is not that of one away."""

from __future__ import annotations

from pathlib import Path

import pytest

from ua_fleet.client import ClientIdentity, FleetClient
from ua_fleet.errors import StorageUnavailable


async def test_a_client_blames_no_server_for_its_own_folder(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    identity = ClientIdentity(tmp_path / "file" / "client")
    with pytest.raises(StorageUnavailable, match="the client's certificate cannot be kept there"):
        async with FleetClient.connect("opc.tcp://127.0.0.1:1/ua_fleet", identity=identity):
            pass
