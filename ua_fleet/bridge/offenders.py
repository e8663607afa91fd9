"""Sources that misbehave, and are put aside for a while: each with the reason, and when it is tried again.

A robot that sends what no robot should (lengths that cannot be, a header without a type, bytes without end) costs
itself and nobody else: its driver lets go of it, keeps nothing of it, and looks at it again after a pause. The pause
doubles while the source goes on like that, and begins anew when it has behaved for as long as it was put aside.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Final, NamedTuple

from ua_fleet.bridge.driver import Dropped, Inlet
from ua_fleet.counters import Drop
from ua_fleet.printing import harmless

__all__ = ["Offenders"]

FIRST_PAUSE_S: Final = 1.0
LONGEST_PAUSE_S: Final = 300.0
SHORTEST_TRIAL_S: Final = 10.0
"""A source has to behave for so long, or for as long as it was put aside, until nothing is known against it."""
MOST_OFFENDERS: Final = 4096
"""Sources that are remembered; then the one goes that is tried again first."""
MOST_CHARS: Final = 300
"""Of a reason: it may quote what the source sent."""


class _Offence(NamedTuple):
    reason: str
    pause_s: float
    until: float
    """When it is tried again."""


class Offenders:
    """The sources of one driver that misbehave. Callable from any thread.

    A source has any name that tells it from all others of the driver: a topic, a publisher of a topic, a device.
    """

    def __init__(
        self, inlet: Inlet, *, first_pause_s: float = FIRST_PAUSE_S, longest_pause_s: float = LONGEST_PAUSE_S
    ) -> None:
        """Begin without offenders.

        Args:
            inlet: where each offence is counted.
            first_pause_s: how long a source is put aside the first time.
            longest_pause_s: the pause doubles up to this.
        """
        self._put = inlet.put
        self._first_s, self._longest_s = first_pause_s, longest_pause_s
        self._lock = threading.Lock()
        self._offences: dict[str, _Offence] = {}

    def put_aside(self, source: str, reason: str, now: float) -> float:
        """Put a source aside, and count it; how long, in seconds.

        Args:
            source: its name.
            reason: what it did, in one line for people.
            now: seconds of a monotonic clock.
        """
        with self._lock:
            before = self._standing(source, now)
            pause_s = self._first_s if before is None else min(2 * before.pause_s, self._longest_s)
            if before is None and len(self._offences) >= MOST_OFFENDERS:
                del self._offences[min(self._offences, key=lambda name: self._offences[name].until)]
            self._offences[source] = _Offence(harmless(reason)[:MOST_CHARS], pause_s, now + pause_s)
        self._put(Dropped(Drop.MISBEHAVED))
        return pause_s

    def is_aside(self, source: str, now: float) -> bool:
        """Whether a source is left alone at present."""
        with self._lock:
            offence = self._standing(source, now)
            return offence is not None and now < offence.until

    def forget(self, source: str) -> None:
        """A source is not there any more, and will not be."""
        with self._lock:
            self._offences.pop(source, None)

    def told(self, now: float) -> Mapping[str, str]:
        """Why each source was put aside, for `DriverStatus.aside`; those on trial are among them."""
        with self._lock:
            names = [name for name in list(self._offences) if self._standing(name, now) is not None]
            return {harmless(name)[:MOST_CHARS]: self._offences[name].reason for name in names}

    def _standing(self, source: str, now: float) -> _Offence | None:
        """What is known against a source; forgotten when it has behaved long enough since it was tried again."""
        offence = self._offences.get(source)
        if offence is not None and now >= offence.until + max(offence.pause_s, SHORTEST_TRIAL_S):
            del self._offences[source]
            return None
        return offence
