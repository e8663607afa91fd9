"""Run a simulated controller: see `python -m ua_demo.simulators.ur --help`."""

from __future__ import annotations

import argparse
import asyncio
import signal
import sys
from pathlib import Path

from ua_demo.simulators.ur.controller import Settings
from ua_demo.simulators.ur.kinematics import MODELS
from ua_demo.simulators.ur.server import Ports, UrSimulator


def _parse(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m ua_demo.simulators.ur",
        description="A Universal Robots controller without a robot. Several on one machine: ur-rtde always takes the"
        " usual ports, so give each an address of its own, 127.0.0.2, 127.0.0.3 and so on.",
    )
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (%(default)s)")
    parser.add_argument("--model", default="ur5e", choices=sorted(MODELS), help="arm (%(default)s)")
    parser.add_argument("--programs", type=Path, help="folder with NAME.script files, which `load NAME.urp` finds")
    parser.add_argument("--port-offset", type=int, default=0, help="added to all ports, for clients that take others")
    parser.add_argument(
        "--unlock-after", type=float, default=5.0, metavar="S", help="age of a protective stop (%(default)s)"
    )
    parser.add_argument("--boot", type=float, default=1.0, metavar="S", help="from power on to idle (%(default)s)")
    parser.add_argument("--brakes", type=float, default=0.5, metavar="S", help="to release the brakes (%(default)s)")
    parser.add_argument("--off", action="store_true", help="begin without power; otherwise the arm is ready")
    return parser.parse_args(arguments)


def _settings(options: argparse.Namespace) -> Settings:
    folder: Path | None = options.programs
    files = sorted(folder.glob("*.script")) if folder is not None else []
    return Settings(
        model=MODELS[options.model],
        boot_s=options.boot,
        brake_s=options.brakes,
        unlock_after_s=options.unlock_after,
        programs={f"{file.stem}.urp": file.read_text(encoding="utf-8") for file in files},
        on_started=lambda name: print(f"told: program {name}", flush=True),
    )


async def _run(options: argparse.Namespace, settings: Settings) -> None:
    ports = Ports().shifted(options.port_offset)
    async with UrSimulator(settings, options.host, ports) as simulator:
        if not options.off:
            simulator.controller.start_up()
        running = asyncio.ensure_future(simulator.run())
        for number in (signal.SIGTERM, signal.SIGINT):
            asyncio.get_running_loop().add_signal_handler(number, running.cancel)
        print(f"ready: {settings.model.name} at {options.host}, dashboard on {ports.dashboard}", flush=True)
        try:
            await running
        except asyncio.CancelledError:
            return


def main(arguments: list[str]) -> int:
    """Run until it is ended; the exit code."""
    options = _parse(arguments)
    try:
        asyncio.run(_run(options, _settings(options)))
    except OSError as error:
        print(f"cannot listen on {options.host}: {error}; choose another --host", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
