"""Which device is which: what udev says of it against the rules of `fleet.yaml`. Pure.

Each rule has at most one device, and each device belongs to at most one rule: the first of both that fits. What fits a
rule that has its device already waits, and takes over when that one is pulled out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import NamedTuple

from ua_bridges.plugged.config import Match

__all__ = ["DeviceFacts", "Plugged", "Plugs", "Unplugged", "fits"]


@dataclass(frozen=True, slots=True)
class DeviceFacts:
    """What is known of a device."""

    id: str
    """Its path below /sys: what tells one from another."""
    subsystem: str
    node: str | None = None
    """Its file, e.g. `/dev/ttyACM0`."""
    vendor: str = ""
    product: str = ""
    serial: str = ""
    properties: Mapping[str, str] = field(default_factory=dict[str, str])
    attributes: Mapping[str, str] = field(default_factory=dict[str, str])
    """Those that a rule names, where the device has them."""

    @property
    def place(self) -> str:
        """Where it is, for people."""
        return self.node or self.id


class Plugged(NamedTuple):
    """A rule has its device."""

    rule: str
    device: DeviceFacts


class Unplugged(NamedTuple):
    """A rule's device is gone."""

    rule: str
    device: DeviceFacts


def fits(rule: Match, device: DeviceFacts) -> bool:
    """Whether a device is what a rule means."""
    if rule.subsystem != device.subsystem:
        return False
    for wanted, there in ((rule.vendor, device.vendor), (rule.product, device.product)):
        if wanted is not None and wanted.lower() != there.lower():
            return False
    if rule.serial is not None and rule.serial != device.serial:
        return False
    if rule.node is not None and not fnmatchcase(device.node or "", rule.node):
        return False
    return all(device.properties.get(name) == value for name, value in rule.properties.items()) and all(
        device.attributes.get(name) == value for name, value in rule.attributes.items()
    )


class Plugs:
    """The devices that are there, and the rules that have one."""

    def __init__(self, rules: Mapping[str, Match]) -> None:
        self._rules = rules
        self._devices: dict[str, DeviceFacts] = {}
        self._device_of: dict[str, DeviceFacts] = {}
        self._rule_of: dict[str, str] = {}

    def device_of(self, rule: str) -> DeviceFacts | None:
        """The device that a rule has."""
        return self._device_of.get(rule)

    def others(self, rule: str) -> list[DeviceFacts]:
        """Devices that fit a rule too, and that no rule has."""
        match = self._rules[rule]
        return [device for device in self._devices.values() if device.id not in self._rule_of and fits(match, device)]

    def appeared(self, device: DeviceFacts) -> list[Plugged | Unplugged]:
        """A device was plugged in, or udev says other things of it."""
        if self._devices.get(device.id) == device:
            return []
        changes = self.vanished(device.id)
        self._devices[device.id] = device
        return changes + self._share_out()

    def vanished(self, id: str) -> list[Plugged | Unplugged]:
        """A device is gone."""
        device = self._devices.pop(id, None)
        rule = self._rule_of.pop(id, None)
        if device is None or rule is None:
            return []
        del self._device_of[rule]
        return [Unplugged(rule, device), *self._share_out()]

    def there(self, devices: Mapping[str, DeviceFacts]) -> list[Plugged | Unplugged]:
        """All devices anew, since events were lost."""
        changes: list[Plugged | Unplugged] = []
        for gone in [known for known in self._devices if known not in devices]:
            changes += self.vanished(gone)
        for device in devices.values():
            changes += self.appeared(device)
        return changes

    def _share_out(self) -> list[Plugged | Unplugged]:
        changes: list[Plugged | Unplugged] = []
        for name, rule in self._rules.items():
            if name in self._device_of:
                continue
            for device in self._devices.values():
                if device.id not in self._rule_of and fits(rule, device):
                    self._device_of[name], self._rule_of[device.id] = device, name
                    changes.append(Plugged(name, device))
                    break
        return changes
