"""`history` in `fleet.yaml`: what is kept of values, and for how long."""

from __future__ import annotations

from typing import Annotated, Final
from urllib.parse import parse_qs, urlsplit

from pydantic import Field, model_validator

from ua_fleet.config.base import Model

__all__ = ["EventHistoryConfig", "HistoryConfig", "ValueHistoryConfig"]

Seconds = Annotated[float, Field(ge=0, le=1e7, allow_inf_nan=False)]
Deadband = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Days = Annotated[float, Field(gt=0, le=36_500, allow_inf_nan=False)]
MEGABYTE: Final = 1_000_000


class ValueHistoryConfig(Model, frozen=True):
    """What is kept of the values of a robot or of one data source, where that differs from what is said above it."""

    deadband: Deadband | None = None
    """A number is kept when it differs from the one kept last by more than this; in the unit of the value. It is for
    numbers alone."""
    at_most_each_s: Seconds | None = None
    """Seconds from one kept value to the next at least. The last value always arrives, and changes of quality do not
    wait."""
    at_least_each_s: Seconds | None = None
    """A value that arrives so long after the kept one is kept even though it is the same; 0: never."""
    days: Days | None = None
    """For how long values are kept."""


class EventHistoryConfig(Model, frozen=True):
    """What is kept of events."""

    days: Days | None = None
    """For how long events are kept; without it as long as values."""
    audit: bool = True
    """Keep AuditEvents too: logins, writes, Method calls. Only engineers can read them."""


_TLS_KEYS: Final = frozenset(("sslmode", "sslrootcert", "sslcert", "sslkey"))


class HistoryConfig(Model, frozen=True):
    """The history of values, in `history.db` in the server's `state_dir` or in PostgreSQL; see docs/history.md."""

    store: str | None = Field(default=None, max_length=1024, examples=["postgresql://db.plant:5432/history"])
    """A PostgreSQL database in place of the file, `postgresql://HOST:PORT/DATABASE`, of this server alone; with
    `?sslmode=verify-full` behind it by TLS."""
    user: str | None = Field(default=None, min_length=1, max_length=63)
    """User there."""
    password_file: str | None = None
    """File whose first line is the user's password there; relative to `fleet.yaml`. Only its owner may read it."""

    record: bool = True
    """Keep the values of all robots. `false`: of those robots and data sources alone that have a `history` of their
    own."""
    megabytes: float = Field(default=1000, ge=10, le=1e7, allow_inf_nan=False)
    """What the store takes at most; the oldest values and events give way."""
    events: EventHistoryConfig | bool = True
    """Keep events: of runs, steps, skills, faults, alarms and dialogs. `false`: none."""
    days: Days = 30
    """For how long values are kept."""
    deadband: Deadband = 0
    """As of a robot; 0: each change is kept."""
    at_most_each_s: Seconds = 0
    """As of a robot; 0: no limit."""
    at_least_each_s: Seconds = 60
    """As of a robot."""

    @model_validator(mode="after")
    def _check(self) -> HistoryConfig:
        if self.store is not None:
            _check_url(self.store)
            if self.user is None:
                raise ValueError("a PostgreSQL database has users: write `user` too")
        elif self.password_file is not None or self.user is not None:
            raise ValueError("user and password_file are of a PostgreSQL database: write `store` too, or remove them")
        return self


def _check_url(url: str) -> None:
    """Raise ValueError for an address that is none of a PostgreSQL database. A password in it is not repeated."""
    form = "write postgresql://HOST:PORT/DATABASE"
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError:
        raise ValueError(f"store is no address; {form}") from None
    if parts.scheme != "postgresql":
        raise ValueError(f"store begins with another word than postgresql://; {form}, or remove it for SQLite")
    if "@" in parts.netloc:
        raise ValueError("store has a user in it; write that as `user`, and the password into a file (`password_file`)")
    if not parts.hostname or not parts.path.strip("/") or port == 0 or parts.fragment:
        raise ValueError(f"store has no host or database; {form}")
    if unknown := sorted(parse_qs(parts.query, keep_blank_values=True).keys() - _TLS_KEYS):
        raise ValueError(f"store has the unknown setting {unknown[0]}; it may have {', '.join(sorted(_TLS_KEYS))}")
