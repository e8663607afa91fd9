"""What the commands of `ua-fleet demo` have in common."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from ua_fleet.cli.endings import UsageError
from ua_fleet.cli.output import message, print_line
from ua_fleet.errors import ConfigError

if TYPE_CHECKING:
    from ua_demo.result import DemoResult
    from ua_demo.site import Site

__all__ = [
    "CONSOLE_PORT",
    "ConsolePort",
    "NoConsole",
    "PubSubUrls",
    "WithBroker",
    "check_broker",
    "report_writer",
    "shown_until_ctrl_c",
    "tell_how_to_connect",
    "tell_result",
]

CONSOLE_PORT: Final = 8080
NoConsole = Annotated[bool, typer.Option("--no-console", help="Start no web console.")]
PubSubUrls = Annotated[
    list[str] | None,
    typer.Option(help="PubSub address, e.g. opc.udp://239.1.2.3:4840; of a clustered MQTT broker several, its nodes'."),
]
WithBroker = Annotated[
    bool, typer.Option("--broker", help="Carry PubSub over an MQTT broker (mosquitto), which is started for it.")
]
ConsolePort = Annotated[int, typer.Option(help="TCP port of the web console.", min=1, max=65535)]


def check_broker(is_wanted: bool, pubsub_urls: Sequence[str] | None) -> None:
    """Raise UsageError where a broker is to be started, and PubSub to go elsewhere; DemoFailed where there is none."""
    from ua_demo.broker import find_broker

    if is_wanted and pubsub_urls:
        raise UsageError(
            "--broker starts a broker of its own: leave out --pubsub-url, or name that of yours without it"
        )
    if is_wanted:
        find_broker()


def report_writer(path: Path | None) -> Callable[[Mapping[str, Any]], None]:
    """What writes a report to a file. After the run would be late to learn that it cannot be written.

    Raises:
        ConfigError: it cannot be written.
    """
    if path is None:
        return lambda _report: None
    if path.is_dir() or not os.access(path if path.exists() else path.resolve().parent, os.W_OK):
        raise ConfigError("the result cannot be written there; choose another --json", file=str(path))

    def write(report: Mapping[str, Any]) -> None:
        path.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")

    return write


def tell_result(result: DemoResult) -> None:
    """Print how a run ended."""
    print_line("")
    for line in result.lines:
        print_line(line)
    for problem in result.problems:
        message(f"ua-fleet: {problem}")


@contextmanager
def shown_until_ctrl_c(is_over: Callable[[], bool]) -> Generator[None]:
    """Ctrl-C is how a demonstration that stays up ends, and no failure once `is_over`; before, it says that it was."""
    try:
        yield
    except KeyboardInterrupt:
        if not is_over():
            message("")  # after the ^C
            message("ended too early; all of its processes are ended, too")
            raise


def tell_how_to_connect(site: Site) -> None:
    """Say what a browser and UaExpert need."""
    from ua_demo.site import ENGINEER, KEY_LIFETIME_S, USER

    if site.console_url:
        message(f"browser:  {site.console_url}  (the web console; log in with the user and password below)")
    message(f"UaExpert: {site.endpoint}  (Basic256Sha256, Sign & Encrypt)")
    message(f"          user {USER}, password {site.password}")
    message(f"          user {ENGINEER}, same password: stores scenarios too, and sees messages and the audit log")
    if site.broker_port is not None:
        message(f"MQTT:     mosquitto_sub -h 127.0.0.1 -p {site.broker_port} -v -F '%t %l bytes' -t '#'")
    if site.secure:
        message(f"PubSub:   signed and encrypted, keys from the server, changed every {KEY_LIFETIME_S} s")
