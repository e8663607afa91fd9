"""Session keys in the keyring of the desktop, by the package keyring, where that is installed and works.

What it does wrong, and there are many backends, is no reason to fail: the key is kept in the file then.
"""

from __future__ import annotations

import importlib
from typing import Any, Final

__all__ = ["read", "remove", "write"]

_SERVICE: Final = "ua-fleet"


def _keyring() -> Any:
    """The package with a backend that keeps something; None without."""
    try:
        package = importlib.import_module("keyring")
        # The backends fail and null have the priorities 0 and -1.
        return package if package.get_keyring().priority > 0 else None
    except Exception:  # noqa: BLE001 - it is not there, or its backend does not work
        return None


def write(key_id: str, key: str) -> bool:
    """Keep a key; whether the keyring has it now."""
    package = _keyring()
    if package is None:
        return False
    try:
        package.set_password(_SERVICE, key_id, key)
        return bool(package.get_password(_SERVICE, key_id) == key)
    except Exception:  # noqa: BLE001 - locked, refused by its user, or broken
        return False


def read(key_id: str) -> str | None:
    """A key; None where it is not there or the keyring is locked."""
    package = _keyring()
    try:
        found = package.get_password(_SERVICE, key_id) if package is not None else None
    except Exception:  # noqa: BLE001 - locked, refused by its user, or broken
        return None
    return found if isinstance(found, str) else None


def remove(key_id: str) -> None:
    """Forget a key."""
    package = _keyring()
    if package is not None:
        try:
            package.delete_password(_SERVICE, key_id)
        except Exception:  # noqa: BLE001 - what is not there is forgotten already
            return
