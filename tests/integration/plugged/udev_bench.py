"""The driver among devices that umockdev plays: `umockdev-wrapper python udev_bench.py FLEET`.

One JSON object for each line on stdin, and one that answers it on stdout; what the driver tells comes in between.
"""

from __future__ import annotations

import asyncio
import ctypes
import json
import logging
import sys
from pathlib import Path
from typing import Any

from ua_bridges.plugged.driver import PluggedDriver

from ua_fleet.bridge import DriverEvent, SampleRead, SourceFound, SourceLost
from ua_fleet.config.load import load_content
from ua_fleet.topics import Topic

LIBRARY = ctypes.CDLL("libumockdev.so.0")
_TEXTS = ctypes.POINTER(ctypes.c_char_p)


def _declare(name: str, result: Any, *arguments: Any) -> Any:
    function = LIBRARY[f"umockdev_testbed_{name}"]
    function.restype, function.argtypes = result, arguments
    return function


NEW = _declare("new", ctypes.c_void_p)
ROOT = _declare("get_root_dir", ctypes.c_char_p, ctypes.c_void_p)
ADD = _declare(
    "add_devicev",
    ctypes.c_char_p,
    ctypes.c_void_p,
    *(ctypes.c_char_p, ctypes.c_char_p, ctypes.c_char_p, _TEXTS, _TEXTS),
)
TELL = _declare("uevent", None, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_char_p)
REMOVE = _declare("remove_device", None, ctypes.c_void_p, ctypes.c_char_p)


def texts(values: dict[str, str]) -> Any:
    flat = [text.encode() for pair in values.items() for text in pair]
    return (ctypes.c_char_p * (len(flat) + 1))(*flat, None)


class Teller:
    """See Inlet."""

    def put(self, event: DriverEvent) -> None:
        if isinstance(event, SourceFound | SourceLost):
            say({"event": "found" if isinstance(event, SourceFound) else "lost", "id": event.topic.id})
        elif isinstance(event, SampleRead) and event.status == 0:
            say({"event": "read", "id": event.topic.id, "values": list(event.values)})


def say(what: dict[str, Any]) -> None:
    print(json.dumps(what), flush=True)


def obey(bed: Any, driver: PluggedDriver, asked: dict[str, Any]) -> dict[str, Any]:
    match asked["do"]:
        case "plug":
            parent = None if asked["parent"] is None else str(asked["parent"]).encode()
            subsystem, name = str(asked["subsystem"]).encode(), str(asked["name"]).encode()
            path = ADD(bed, subsystem, name, parent, texts(asked["attributes"]), texts(asked["properties"]))
            TELL(bed, path, b"add")
            return {"path": path.decode()}
        case "pull":
            path = str(asked["path"]).encode()
            TELL(bed, path, b"remove")
            REMOVE(bed, path)
            return {}
        case "want":
            driver.want(frozenset([Topic(300, 2, number) for number in asked["ids"]]))
            return {}
        case _:
            return {"detail": driver.status().detail}


async def main(fleet: str) -> None:
    bed = NEW()
    driver = PluggedDriver(load_content(Path(fleet).read_bytes(), "fleet.yaml", {}), "pc")
    await driver.start(Teller())
    say({"root": ROOT(bed).decode()})
    loop = asyncio.get_running_loop()
    try:
        while line := await loop.run_in_executor(None, sys.stdin.readline):
            say(obey(bed, driver, json.loads(line)))
    finally:
        await driver.stop()


logging.basicConfig(stream=sys.stderr, level=logging.INFO, format="%(message)s")
asyncio.run(main(sys.argv[1]))
