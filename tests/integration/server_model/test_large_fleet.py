"""A fleet of several namespaces, a space each, whose data has the same ids: through a whole server over UDP.

It is small here; `python -m tests.integration.server_model.large_fleet 1667` is the same with 5,000 robots.
"""

from __future__ import annotations

from pathlib import Path

from tests.integration.server_model.large_fleet import carried


async def test_a_space_for_each_namespace_carries_its_values(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    await carried(4, udp_url, tcp_port, tmp_path)
