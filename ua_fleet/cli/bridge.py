"""`ua-fleet bridge NAME`: one UA bridge."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import typer

from ua_fleet.cli.endings import NotFound
from ua_fleet.cli.key_source import key_source_of
from ua_fleet.cli.logs import set_up_logging
from ua_fleet.cli.monitored import monitored
from ua_fleet.cli.options import DEFAULT_CONFIG, Config, Json, WithoutLoopRule, load_config
from ua_fleet.cli.output import message, print_json, print_line
from ua_fleet.cli.process import run
from ua_fleet.cli.rules import rule_for
from ua_fleet.cli.traffic_log import TrafficLogFile, traffic_log

__all__ = ["EXAMPLES", "bridge"]

EXAMPLES = ("ua-fleet bridge floor", ".venv-ros1/bin/ua-fleet bridge cell -c hall2.yaml")


def bridge(
    name: Annotated[str, typer.Argument(help="Name of the bridge in the configuration file.")],
    config: Config = DEFAULT_CONFIG,
    as_json: Json = False,
    traffic_file: TrafficLogFile = None,
    without_loop_rule: WithoutLoopRule = False,
) -> None:
    """Run one UA bridge between its space and OPC UA PubSub until Ctrl-C.

    Each bridge is a process of its own. A ROS 1 bridge runs on the system's Python with rospy, in `.venv-ros1`; it
    waits for a ROS master that is not up yet.
    """
    fleet = load_config(config)
    if name not in fleet.bridges:
        there = ", ".join(fleet.bridges) or "none"
        raise NotFound(f"{config}: there is no bridge {name!r}; bridges there: {there}")
    set_up_logging(process="bridge", bridge=name)
    from ua_fleet.bridge.registry import load_driver
    from ua_fleet.bridge.runner import run_bridge
    from ua_fleet.carrier import carrier_of
    from ua_fleet.config.teleoperation import setpoint_heads
    from ua_fleet.config.transports import open_transports
    from ua_fleet.monitoring import ProcessKind

    transports = open_transports(
        fleet,
        config.resolve().parent,
        space=fleet.bridges[name].space,
        hears_itself=without_loop_rule,
        urgent_heads=setpoint_heads(fleet, fleet.bridges[name].space),
    )
    state_dir = config.resolve().parent / fleet.state_dir_of(name)
    source = key_source_of(fleet, name, config.resolve().parent, state_dir)
    driver = load_driver(fleet, name)
    carry = carrier_of(fleet, name, state_dir) if driver.has_skills else None

    def ready() -> None:
        if as_json:
            print_json({"ready": True, "bridge": name})
        else:
            print_line(f"ready: bridge {name}")

    async def bridged(sent: Callable[[bytes, int], None] | None) -> None:
        own = fleet.bridges[name].monitoring_port
        watched = monitored(
            fleet.monitoring,
            ProcessKind.BRIDGE,
            name,
            state_dir,
            port=own,
            port_key=f"bridges.{name}.monitoring_port",
        )
        async with watched as monitor, source as keys:
            await run_bridge(
                fleet,
                name,
                driver,
                transports,
                state_dir=state_dir,
                keys=keys,
                ready=ready,
                rule=rule_for(without_loop_rule),
                sent=sent,
                monitor=monitor,
                carry=carry,
            )

    message(f"bridge {name} ({fleet.bridges[name].kind}, space {fleet.bridges[name].space}); end it with Ctrl-C")
    with traffic_log(traffic_file, fleet) as sent:
        run(bridged(sent))
