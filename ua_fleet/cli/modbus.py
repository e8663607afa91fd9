"""`ua-fleet modbus ...`: the fleet as a Modbus device."""

from __future__ import annotations

from contextlib import AbstractAsyncContextManager
from typing import TYPE_CHECKING

from ua_fleet.cli.connect import connected
from ua_fleet.cli.endings import NotFound, extra_needed
from ua_fleet.cli.logs import set_up_logging
from ua_fleet.cli.monitored import monitored
from ua_fleet.cli.options import DEFAULT_CONFIG, Config, ConnectionOptions, Json, connecting, load_config
from ua_fleet.cli.output import message, print_json, print_line
from ua_fleet.cli.process import run

if TYPE_CHECKING:
    from pathlib import Path

    from ua_fleet.client import FleetClient
    from ua_fleet.config.modbus_schema import ModbusServerConfig
    from ua_fleet.config.schema import FleetConfig

__all__ = ["MAP_EXAMPLES", "SERVE_EXAMPLES", "serve", "show_map"]

SERVE_EXAMPLES = (
    "ua-fleet modbus serve -u plc1",
    "ua-fleet modbus serve -c hall2.yaml -u plc1 --password-file plc1.pw",
)
MAP_EXAMPLES = ("ua-fleet modbus map", "ua-fleet modbus map --json")
MEMORY = "commands.db"


def _modbus_of(path: Path) -> tuple[FleetConfig, ModbusServerConfig]:
    fleet = load_config(path)
    if fleet.modbus is None:
        raise NotFound(f"{path} has no section `modbus`; docs/plc.md tells what stands in it")
    return fleet, fleet.modbus


@connecting
def serve(
    connection: ConnectionOptions,
    config: Config = DEFAULT_CONFIG,
    as_json: Json = False,
) -> None:
    """Serve the fleet as a Modbus/TCP device that PLCs read and by which they command the fleet, until Ctrl-C.

    The section `modbus` of the configuration defines the addresses. All actions of PLCs run under the user that is
    given here: add a user for them, with the role that they need.
    """
    fleet, modbus = _modbus_of(config)
    set_up_logging(process="modbus")
    with extra_needed("this command", "modbus"):
        from ua_fleet.modbus.figures import GatewayFigures
        from ua_fleet.modbus.listener import ModbusListener
    from ua_fleet.modbus.gateway import Gateway
    from ua_fleet.modbus.memory import CommandMemory
    from ua_fleet.monitoring import ProcessKind
    from ua_fleet.storage.control import state_control

    folder = config.resolve().parent / modbus.state_dir

    def connect() -> AbstractAsyncContextManager[FleetClient]:
        return connected(connection)

    watched = monitored(
        fleet.monitoring,
        ProcessKind.MODBUS,
        "",
        folder,
        port=modbus.monitoring_port,
        port_key="modbus.monitoring_port",
    )

    async def served() -> None:
        memory = CommandMemory(folder / MEMORY)
        try:
            gateway = Gateway(fleet, memory)
            control = state_control(folder, "modbus")
            async with watched as monitor, control, ModbusListener(gateway.image, modbus, gateway.written) as listener:
                monitor.mistakes = gateway.mistakes
                place = f"{modbus.host}:{modbus.port}"
                if as_json:
                    print_json({"ready": True, "modbus": place})
                else:
                    print_line(f"ready: Modbus at {place}, unit {modbus.unit}")
                GatewayFigures(gateway, listener, place).tell(monitor)
                await gateway.run(connect)
        finally:
            memory.close()

    if not modbus.writers:
        message("modbus.writers is empty: no client may write or command")
    run(served())


def show_map(config: Config = DEFAULT_CONFIG, as_json: Json = False) -> None:
    """Print the addresses and their contents, as a table in Markdown."""
    from ua_fleet.modbus.table import map_rows, markdown

    fleet, _ = _modbus_of(config)
    if not as_json:
        for line in markdown(fleet).splitlines():
            print_line(line)
        return
    for row in map_rows(fleet):
        register = row.register
        print_json(
            {
                "table": register.table.value,
                "address": register.address,
                "count": register.span.count,
                "type": register.type.value,
                "bit": register.bit,
                "scale": register.scale,
                "offset": register.offset,
                "order": register.order.value,
                "name": row.name,
                "unit": row.unit,
                "plc_writes": row.is_written,
                "meaning": row.text,
            }
        )
