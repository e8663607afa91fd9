"""A network of one cable, with an end in a network namespace of its own: what runs there can be cut off."""

from __future__ import annotations

import contextlib
import functools
import secrets
import subprocess
from collections.abc import Generator

__all__ = ["Cable", "cable", "missing_namespaces"]

_DROP_ALL = """
table inet cut {
    chain in { type filter hook input priority 0; policy drop; }
    chain out { type filter hook output priority 0; policy drop; }
}
"""
"""Loopback too: who is cut off talks to nobody by its address."""
_KEEP_LOOPBACK = ("in iif lo accept", "out oif lo accept")


def _run(*args: str, text: str | None = None) -> None:
    done = subprocess.run(args, input=text, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(args)}: {done.stderr.strip()}")


@functools.cache
def missing_namespaces() -> str | None:
    """Why no network namespaces can be made here; None where they can."""
    try:
        with cable() as made:
            made.drop()
            made.pass_on()
    except (OSError, RuntimeError) as error:
        return f"network namespaces cannot be made ({error}); they need root, iproute2 and nftables"
    return None


class Cable:
    """A pair of interfaces: one here, one in the namespace."""

    def __init__(self, name: str, near: str, far: str) -> None:
        """`name` is of the namespace and of the interfaces, `near` and `far` are the addresses of their ends."""
        self.name, self.near, self.far = name, near, far
        self.prefix = ("ip", "netns", "exec", name)
        """Before a command that is to run at the far end."""

    def unplug(self) -> None:
        """Take the far end's interface down."""
        _run("ip", "-n", self.name, "link", "set", "far", "down")

    def plug(self) -> None:
        """Give it back."""
        _run("ip", "-n", self.name, "link", "set", "far", "up")

    def drop(self) -> None:
        """Lose every packet, both ways, in silence."""
        _run(*self.prefix, "nft", "-f", "-", text=_DROP_ALL)
        for rule in _KEEP_LOOPBACK:
            _run(*self.prefix, "nft", "insert", "rule", "inet", "cut", *rule.split())

    def pass_on(self) -> None:
        """Lose nothing any more."""
        _run(*self.prefix, "nft", "delete", "table", "inet", "cut")


@contextlib.contextmanager
def cable() -> Generator[Cable]:
    """Lay a cable, and take it away at the end, with its namespace.

    Raises:
        OSError, RuntimeError: it cannot be done here.
    """
    # 198.18.0.0/15 is for measurements between networks (RFC 2544): no machine has it by itself.
    tag = secrets.token_hex(4)
    name, network = f"uaf-{tag}", f"198.18.{int(tag[:2], 16)}.{int(tag[2:4], 16) & 0xFC}"
    base, last = network.rsplit(".", 1)
    made = Cable(name, f"{base}.{int(last) + 1}", f"{base}.{int(last) + 2}")
    _run("ip", "netns", "add", name)
    try:
        _run("ip", "link", "add", name, "type", "veth", "peer", "name", "far", "netns", name)
        _run("ip", "addr", "add", f"{made.near}/30", "dev", name)
        _run("ip", "-n", name, "addr", "add", f"{made.far}/30", "dev", "far")
        _run("ip", "link", "set", name, "up")
        for interface in ("lo", "far"):
            _run("ip", "-n", name, "link", "set", interface, "up")
        yield made
    finally:
        # With the namespace its end goes, and with that this one.
        _run("ip", "netns", "del", name)
