"""Private keys that tests have read before, which OpenSSL would examine anew for 0.06 s each time.

A session of a test's client took 0.08 s of computing, of which reading its own key was the most.
"""

from __future__ import annotations

import functools
from typing import Any

from cryptography.hazmat.primitives import serialization

__all__ = ["keep"]


def keep() -> None:
    """Have the same bytes be the same key in this process; modules that are imported from now on read by this."""
    module: Any = serialization
    if not hasattr(module.load_pem_private_key, "cache_info"):
        module.load_pem_private_key = functools.cache(module.load_pem_private_key)
