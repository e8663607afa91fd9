"""What the commands of `ua-fleet demo` have in common."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ua_fleet.cli.output import message

if TYPE_CHECKING:
    from ua_fleet.demo.site import Site

__all__ = ["tell_how_to_connect"]


def tell_how_to_connect(site: Site) -> None:
    """Say what UaExpert needs."""
    from ua_fleet.demo.site import KEY_LIFETIME_S, USER

    message(f"UaExpert: {site.endpoint}  (Basic256Sha256, Sign & Encrypt)")
    message(f"          user {USER}, password {site.password}")
    if site.secure:
        message(f"PubSub:   signed and encrypted, keys from the server, changed every {KEY_LIFETIME_S} s")
