"""`ua-fleet console`: the web console."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ua_fleet.cli.endings import UsageError, extra_needed
from ua_fleet.cli.logs import set_up_logging
from ua_fleet.cli.options import DEFAULT_ENDPOINT, Json
from ua_fleet.cli.output import message, print_json, print_line
from ua_fleet.cli.process import run

if TYPE_CHECKING:
    from ua_fleet.console.settings import ConsoleSettings

__all__ = ["EXAMPLES", "console"]

EXAMPLES = (
    "ua-fleet console",
    "ua-fleet console --fleet hall=opc.tcp://10.0.0.5:4840/ua_fleet --fleet yard=opc.tcp://10.0.0.6:4840/ua_fleet",
    "ua-fleet console --config console.yaml",
)


def console(
    config: Annotated[
        Path | None,
        typer.Option(
            "--config", "-c", envvar="UA_FLEET_CONSOLE", help="File with the console's settings: console.yaml."
        ),
    ] = None,
    fleet: Annotated[
        list[str] | None,
        typer.Option(
            help=f"A fleet and its server, NAME=ENDPOINT; once for each fleet. Without it: {DEFAULT_ENDPOINT}."
        ),
    ] = None,
    listen: Annotated[
        str | None, typer.Option(help="Address and port to listen on; without it 127.0.0.1:8080. Port 0: any.")
    ] = None,
    allow_host: Annotated[
        list[str] | None,
        typer.Option(help="A host name by which browsers reach the console; needed if it is not loopback."),
    ] = None,
    plain_http: Annotated[
        bool,
        typer.Option(
            "--plain-http",
            help="Allow HTTP without TLS on other addresses than loopback, for example behind a TLS proxy.",
        ),
    ] = False,
    as_json: Json = False,
) -> None:
    """Serve the web console of one fleet or several until Ctrl-C.

    The console is an OPC UA client: people log in as users of the server, and have the rights of that user. It listens
    on loopback by default.
    """
    given: dict[str, Any] = {}
    if fleet:
        given["fleets"] = dict(_named(one) for one in fleet)
    elif config is None:
        given["fleets"] = {"fleet": {"endpoint": DEFAULT_ENDPOINT}}
    if listen is not None:
        given["listen"] = listen
    if allow_host:
        given["allowed_hosts"] = allow_host
    if plain_http:
        given["plain_http"] = True
    set_up_logging(process="console")
    with extra_needed("the console", "console"):
        from ua_fleet.console.load import load_settings
        from ua_fleet.console.run import run_console
    settings = load_settings(config, given)
    _tell_what_is_weak(settings)

    def ready(url: str) -> None:
        if as_json:
            print_json({"ready": True, "url": url})
        else:
            print_line(f"ready: {url}")

    run(run_console(settings, ready=ready))


def _named(text: str) -> tuple[str, dict[str, str]]:
    name, equals, endpoint = text.partition("=")
    if not (name and equals and endpoint):
        raise UsageError(f"{text!r} is no fleet; write --fleet NAME=ENDPOINT, such as --fleet hall={DEFAULT_ENDPOINT}")
    return name, {"endpoint": endpoint}


def _tell_what_is_weak(settings: ConsoleSettings) -> None:
    from ua_fleet.console.page import page_missing

    if problem := page_missing():
        message(problem)
    if not settings.is_loopback and settings.tls is None:
        message(
            f"passwords and cookies go unencrypted over {settings.listen} (plain_http): only a proxy that does TLS may "
            "reach it"
        )
    for name, one in settings.fleets.items():
        if one.insecure:
            message(f"passwords go unencrypted to {name}, {one.endpoint} (insecure)")
