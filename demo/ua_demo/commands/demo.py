"""`ua-fleet demo`: the two demonstrations."""

from __future__ import annotations

from ua_demo.commands import pal, talkrobots
from ua_fleet.cli.command_group import add_command, command_group

__all__ = ["app"]

app = command_group("Demonstrations with real robots' programs.")
add_command(app, "pal", pal.pal, pal.EXAMPLES)
add_command(app, "talkrobots", talkrobots.talkrobots, talkrobots.EXAMPLES)
