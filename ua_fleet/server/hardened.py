"""The OPC UA server that the fleet stands on: asyncua's address space behind our own, closed door."""

# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import asyncua
from asyncua import ua

from ua_fleet.config.schema import ServerConfig
from ua_fleet.server.certificates import ensure_application_certificate
from ua_fleet.server.users import User

__all__ = ["HardenedServer", "NodeGate", "create_server"]


class NodeGate(Protocol):
    """The model behind the nodes, which has the last word on what clients write."""

    def check_write(self, node_id: ua.NodeId, value: ua.DataValue, user: User) -> int:
        """StatusCode of a write before it happens; 0 lets it go on."""
        ...

    def written(self, node_id: ua.NodeId, value: ua.DataValue, user: User) -> None:
        """A client's write has been done; the node has this value."""
        ...


class HardenedServer(asyncua.Server):
    """asyncua's server; set `gate` before `start`."""

    gate: NodeGate | None = None


async def create_server(config: ServerConfig, state_dir: Path, *, application_uri: str) -> HardenedServer:
    """A server that is initialised and not started, with its certificates, users and limits in place."""
    server = HardenedServer()
    await server.init()
    await server.set_application_uri(application_uri)
    server.set_endpoint(f"opc.tcp://{config.host}:{config.port}/{config.path}")
    files = ensure_application_certificate(state_dir, application_uri, [config.host])
    await server.load_certificate(files.certificate)
    await server.load_private_key(files.private_key)
    return server
