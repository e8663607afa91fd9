"""Devices as udev tells of them, and files that stand for devices that udev does not see.

All of it runs in the event loop. The list of devices is read at the start, and again where events were lost.
"""

# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false

from __future__ import annotations

import asyncio
import logging
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final

import pyudev

from ua_bridges.plugged.config import Match
from ua_bridges.plugged.devices import DeviceFacts, Plugged, Plugs, Unplugged

__all__ = ["PathWatch", "UdevWatch"]

LOOK_S: Final = 0.2
"""Period in which files that stand for devices are looked for."""
_MOST_EVENTS: Final = 256
"""Events that are taken at once."""
_RECEIVE_BUFFER_BYTES: Final = 1 << 20

logger = logging.getLogger(__name__)
Changed = Callable[[Sequence[Plugged | Unplugged]], None]


class UdevWatch:
    """Follows the devices of the subsystems that rules name."""

    def __init__(self, rules: Mapping[str, Match], changed: Changed) -> None:
        self.plugs = Plugs(rules)
        self._rules, self._changed = rules, changed
        self._subsystems = sorted({rule.subsystem for rule in rules.values()})
        self._attributes = {
            subsystem: sorted(
                {name for rule in rules.values() if rule.subsystem == subsystem for name in rule.attributes}
            )
            for subsystem in self._subsystems
        }
        self._context: Any = None
        self._monitor: Any = None
        self._told: set[str] = set()

    def start(self) -> None:
        """Begin: listen first, then list what is there, so that nothing is missed between the two."""
        if not self._rules:
            return
        self._context = pyudev.Context()
        self._monitor = monitor = pyudev.Monitor.from_netlink(self._context)
        for subsystem in self._subsystems:
            monitor.filter_by(subsystem)
        try:
            monitor.set_receive_buffer_size(_RECEIVE_BUFFER_BYTES)
        except OSError:
            logger.debug("udev: the kernel keeps its own size of the receive buffer")
        monitor.start()
        asyncio.get_running_loop().add_reader(monitor.fileno(), self._readable)
        self._list()

    def stop(self) -> None:
        """Leave udev. Safe to call twice."""
        if self._monitor is not None:
            asyncio.get_running_loop().remove_reader(self._monitor.fileno())
            self._monitor = None

    def _list(self) -> None:
        found: dict[str, DeviceFacts] = {}
        for subsystem in self._subsystems:
            for device in self._context.list_devices(subsystem=subsystem):
                if (facts := self._facts(device)) is not None:
                    found[facts.id] = facts
        self._tell(self.plugs.there(found))

    def _readable(self) -> None:
        try:
            for _ in range(_MOST_EVENTS):
                device = self._monitor.poll(timeout=0)
                if device is None:
                    return
                if device.action == "remove":
                    self._tell(self.plugs.vanished(str(device.sys_path)))
                elif (facts := self._facts(device)) is not None:
                    self._tell(self.plugs.appeared(facts))
        except OSError as error:  # ENOBUFS: more events than the buffer held
            logger.warning("udev: events were lost (%s); the devices are listed anew", error.strerror or error)
            self._list()

    def _facts(self, device: Any) -> DeviceFacts | None:
        """What is known of a device; None where it is gone already."""
        try:
            subsystem, properties = str(device.subsystem), dict(device.properties)
            usb = device.find_parent("usb", "usb_device")
            attributes = {
                name: value
                for name in self._attributes.get(subsystem, ())
                if (value := _attribute(device, name)) is not None
            }
            node = device.device_node
            return DeviceFacts(
                str(device.sys_path),
                subsystem,
                None if node is None else str(node),
                properties.get("ID_VENDOR_ID") or _attribute(usb, "idVendor") or "",
                properties.get("ID_MODEL_ID") or _attribute(usb, "idProduct") or "",
                properties.get("ID_SERIAL_SHORT") or _attribute(usb, "serial") or "",
                {name: value for name, value in properties.items() if name in self._named(subsystem)},
                attributes,
            )
        except (OSError, KeyError, pyudev.DeviceNotFoundError):
            return None

    def _named(self, subsystem: str) -> set[str]:
        """The properties that rules name: others may change without any matter to us."""
        return {name for rule in self._rules.values() if rule.subsystem == subsystem for name in rule.properties}

    def _tell(self, changes: Sequence[Plugged | Unplugged]) -> None:
        for rule in self._rules:
            others = self.plugs.others(rule)
            taken = self.plugs.device_of(rule)
            for other in others if taken is not None else ():
                if other.id not in self._told:
                    self._told.add(other.id)
                    logger.warning(
                        "device %s: %s fits too, and %s came first; tell them apart, e.g. by `serial`",
                        *(rule, other.place, taken.place if taken is not None else ""),
                    )
        if changes:
            self._changed(changes)


def _attribute(device: Any, name: str) -> str | None:
    if device is None:
        return None
    try:
        return str(device.attributes.asstring(name)).strip()
    except (KeyError, UnicodeDecodeError, OSError):
        return None


class PathWatch:
    """Follows files that stand for devices."""

    def __init__(self, paths: Mapping[str, str], changed: Changed) -> None:
        self._paths, self._changed = paths, changed
        self._there: dict[str, DeviceFacts] = {}
        self._timer: asyncio.TimerHandle | None = None

    def start(self) -> None:
        """Begin, where there is anything to look for."""
        if self._paths:
            self._look()

    def stop(self) -> None:
        """End. Safe to call twice."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def device_of(self, rule: str) -> DeviceFacts | None:
        """The device that a file stands for, while it is there."""
        return self._there.get(rule)

    def _look(self) -> None:
        changes = list(self._changes())
        self._timer = asyncio.get_running_loop().call_later(LOOK_S, self._look)
        if changes:
            self._changed(changes)

    def _changes(self) -> Iterable[Plugged | Unplugged]:
        for rule, path in self._paths.items():
            before, target = self._there.get(rule), os.path.realpath(path)
            is_there = os.path.exists(target)
            if before is not None and (not is_there or before.node != target):
                del self._there[rule]
                yield Unplugged(rule, before)
            if is_there and rule not in self._there:
                self._there[rule] = device = DeviceFacts(target, "", target)
                yield Plugged(rule, device)
