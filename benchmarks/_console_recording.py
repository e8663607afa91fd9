"""What a console tells one page of 1,000 robots with 10 values at 1 Hz: recorded from a real fleet, and played again.

    python -m benchmarks._console_recording record [SECONDS]     anew, into build/benchmarks
    python -m benchmarks._console_recording play [PAGE]          serves the page, or another build of it; prints its URL

The player is the console's own app, page and WebSocket, but for the OPC UA sessions behind them: its feeds tell what
the recording has, again and again, at times of now. So a browser has a machine's cores nearly for itself.
"""

from __future__ import annotations

import asyncio
import contextlib
import gzip
import json
import random
import re
import sys
import tempfile
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final, NamedTuple, cast

import uvicorn

from benchmarks._console_fleet import PEOPLE, live_fleet, robot_name
from benchmarks._quiet import expect_quiet
from benchmarks.harness import Unavailable
from tests import system
from tests.console.conftest import FLEET, TITLE
from tests.integration.console.harness import Browser
from tests.integration.console.harness import Console as Address
from tests.waiting import until
from ua_fleet.console.app import ConsoleApp
from ua_fleet.console.counts import ConsoleCounts
from ua_fleet.console.feeds import FEEDS
from ua_fleet.console.feeds.kinds import FeedParameters
from ua_fleet.console.link import FleetLink, RunningFeed
from ua_fleet.console.page import Page
from ua_fleet.console.people import People
from ua_fleet.console.rights import Rights
from ua_fleet.console.sessions import BrowserSession, BrowserSessions
from ua_fleet.console.settings import ConsoleSettings
from ua_fleet.console.shown import shown_time
from ua_fleet.monitoring.mistakes import Mistakes

ROBOTS: Final = 1000
SECONDS: Final = 60.0
FILE: Final = system.ROOT / "build" / "benchmarks" / "console-1000-robots.jsonl.gz"
WANTED: Final[dict[str, dict[str, Any]]] = {
    "robots": {},
    "robot": {"robot": robot_name(0)},
    "teleoperation": {"robot": robot_name(0)},
    "alarms": {},
    "counts": {},
}
"""Those of the pages of all robots and of one; of another robot the first one's is played."""
FAULTS_EVERY_S: Final = 0.5
SETTLED_S: Final = 65.0
"""Before it is recorded: a fleet in which no robot has come up just now, so ages of states are minutes."""
_TIME: Final = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?Z")


class Told(NamedTuple):
    """A part of a message: when it came, in seconds since the first one, and what changed."""

    at_s: float
    feed: str
    whole: bool
    set: dict[str, Any]
    gone: list[str]


class Recording(NamedTuple):
    began: datetime
    seconds: float
    told: list[Told]


# ---------------------------------------------------------------------- record


async def record(url: str, seconds: float) -> Recording:
    """Look at a live fleet as a page does, while faults come and go."""
    user, _ = PEOPLE["engineer"]
    told: list[Told] = []
    async with Address(url).logged_in(user, FLEET) as browser, browser.live() as live:
        for name, parameters in WANTED.items():
            await live.want(name, name, FLEET, **parameters)
        async with asyncio.timeout(300):
            while not set(WANTED) <= live.feeds.keys() or any(
                one["state"]["v"] == "offline" for one in live.feeds["robots"].values()
            ):
                await live.step()
        settled = time.monotonic() + SETTLED_S
        while time.monotonic() < settled:
            await live.step()
        began, start = datetime.now(UTC), time.monotonic()
        told += [Told(0.0, name, True, dict(entries), []) for name, entries in live.feeds.items()]
        troubling = asyncio.ensure_future(_trouble(browser))
        try:
            while (at := time.monotonic() - start) < seconds:
                message = await live.step()
                for name, change in message["feeds"].items():
                    keys = (*change.get("set", ()), *change.get("part", ()))
                    values = {key: live.feeds[name][key] for key in keys}
                    told.append(Told(at, name, False, values, change.get("gone", [])))
        finally:
            troubling.cancel()
            await asyncio.wait([troubling])
    return Recording(began, seconds, told)


async def _trouble(browser: Browser) -> None:
    """Robots are broken and held by people, and then they are not."""
    chance, broken, held = random.Random(2), list[str](), list[str]()
    while True:
        robot = robot_name(chance.randrange(ROBOTS))
        if chance.random() < 0.5:
            broken.append(robot)
            await browser.ask("fault.raise", robot=robot, reason="the drive does not turn")
        else:
            held.append(robot)
            await browser.ask("robots.hold", robot=robot, reason="battery is changed")
        if len(broken) > 10:
            await browser.ask("fault.clear", fault=broken.pop(0))
        if len(held) > 10:
            await browser.ask("robots.release", robot=held.pop(0))
        await asyncio.sleep(FAULTS_EVERY_S)


def write(recording: Recording, file_path: Path = FILE) -> None:
    file_path.parent.mkdir(parents=True, exist_ok=True)
    with gzip.open(file_path, "wt", encoding="utf-8", compresslevel=6) as file:
        head = {"began": recording.began.isoformat(), "seconds": recording.seconds}
        file.write(json.dumps(head) + "\n")
        file.writelines(json.dumps(one, ensure_ascii=False) + "\n" for one in recording.told)


def read() -> Recording:
    with gzip.open(FILE, "rt", encoding="utf-8") as file:
        head = json.loads(next(file))
        told = [Told(*json.loads(line)) for line in file]
    return Recording(datetime.fromisoformat(head["began"]), head["seconds"], told)


def recorded(seconds: float = SECONDS, file: Path = FILE) -> None:
    """Have the recording; it is made once, on a machine that is left to it: what comes late is in it for ever.

    Raises:
        Unavailable: the machine is busy.
    """
    if file.exists():
        return
    expect_quiet()
    with tempfile.TemporaryDirectory() as folder, live_fleet(ROBOTS, Path(folder)) as running:
        write(asyncio.run(record(running.console.url, seconds)), file)


# ---------------------------------------------------------------------- play


class RecordedLink:
    """What a page takes for a link to a server: its feeds are played."""

    state = "live"

    def __init__(self, fleet: str, user: str, recording: Recording) -> None:
        self.fleet, self.user, self._recording = fleet, user, recording
        self._since = datetime.now(UTC)
        self._tasks: dict[RunningFeed, asyncio.Task[None]] = {}

    @property
    def shown(self) -> dict[str, Any]:
        since = shown_time(self._since)
        return {"state": self.state, "since": since, "reason": "", "user": self.user} | Rights(
            ("observer", "operator", "engineer")
        ).shown

    def listen(self, listener: Callable[[FleetLink], None]) -> None:
        """Nothing ever changes."""

    def unlisten(self, listener: Callable[[FleetLink], None]) -> None:
        """Nothing ever changes."""

    def open_feed(self, name: str, parameters: FeedParameters) -> RunningFeed:
        feed = RunningFeed(FEEDS[name], parameters, name)
        self._tasks[feed] = asyncio.ensure_future(self._play(feed))
        return feed

    def close_feed(self, feed: RunningFeed) -> None:
        self._tasks.pop(feed).cancel()

    async def _play(self, feed: RunningFeed) -> None:
        board = feed.board
        told = [one for one in self._recording.told if one.feed == feed.kind.name]
        is_shown = _shown_keys(feed)
        start = time.monotonic()
        while True:
            later = datetime.now(UTC) - self._recording.began
            for one in told:
                await asyncio.sleep(max(0.0, start + one.at_s - time.monotonic()))
                if one.whole:
                    board.keep(set(one.set))
                for key, value in one.set.items():
                    if is_shown(key):
                        board.put(key, _moved(value, later))
                for key in one.gone:
                    board.gone(key)
                board.ready()
            start += self._recording.seconds
            await asyncio.sleep(max(0.0, start - time.monotonic()))


def _shown_keys(feed: RunningFeed) -> Callable[[str], bool]:
    """Which keys a feed of one robot has, of those of all."""
    robot = getattr(feed.parameters, "robot", "")
    match feed.kind.name:
        case "robots" if robot:
            return lambda key: key == robot
        case "alarms" if robot:
            return lambda key: key.startswith(f"{robot}.")
        case _:
            return lambda key: True


def _moved(value: Any, later: timedelta) -> Any:
    """The same with every time in it so much later."""
    match value:
        case dict():
            return {key: _moved(one, later) for key, one in cast("dict[str, Any]", value).items()}
        case list():
            parts: list[Any] = value  # pyright: ignore[reportUnknownVariableType]
            return [_moved(one, later) for one in parts]
        case str() if _TIME.fullmatch(value):
            return shown_time(datetime.fromisoformat(value) + later)
        case _:
            return value


class RecordedPeople:
    """Lets everybody in, to the recording."""

    def __init__(self, settings: ConsoleSettings, recording: Recording) -> None:
        self.sessions = BrowserSessions(settings.session_idle_s, settings.session_max_s, settings.limits.sessions)
        self.links: list[RecordedLink] = []
        self._recording = recording

    def on_end(self, heard: Callable[[BrowserSession], None]) -> None:
        """No session ever ends."""

    def on_end_no_more(self, heard: Callable[[BrowserSession], None]) -> None:
        """No session ever ends."""

    async def login(
        self, session: BrowserSession | None, fleet: str, user: str, password: str, address: str
    ) -> tuple[BrowserSession, str | None]:
        token: str | None = None
        if session is None:
            begun = self.sessions.begin(time.monotonic())
            assert begun is not None
            session, token = begun
        session.logins[fleet] = RecordedLink(fleet, user, self._recording)
        return session, token


async def play(folder: Path | None = None) -> None:
    port = system.free_tcp_port()
    settings = ConsoleSettings.model_validate(
        {"listen": f"127.0.0.1:{port}", "fleets": {FLEET: {"endpoint": "opc.tcp://127.0.0.1:4840", "title": TITLE}}}
    )
    people = RecordedPeople(settings, read())
    app = ConsoleApp(
        settings, cast("People", people), ConsoleCounts(Mistakes()), "console", Page(folder) if folder else None
    )
    config = uvicorn.Config(
        app.asgi, host="127.0.0.1", port=port, loop="none", ws="websockets-sansio", ws_per_message_deflate=False,
        lifespan="off", log_config=None, access_log=False,
    )  # fmt: skip
    server = uvicorn.Server(config)
    serving = asyncio.ensure_future(server.serve())
    await until(lambda: server.started, "the console's app")
    print(f"http://127.0.0.1:{port}/", flush=True)
    with contextlib.suppress(asyncio.CancelledError):
        await serving


def main() -> None:
    what, *options = sys.argv[1:]
    if what == "play":
        asyncio.run(play(Path(options[0]) if options else None))
    else:
        made = FILE.with_suffix(".new")
        made.unlink(missing_ok=True)
        try:
            recorded(float(options[0]) if options else SECONDS, made)
        except Unavailable as reason:
            sys.exit(f"not recorded: {reason}")
        made.replace(FILE)
        print(f"{FILE}: {FILE.stat().st_size} bytes")


if __name__ == "__main__":
    main()
