"""Fields by their names: two processes may have files that name the same fields in another order, or others.

One rule, for the server's nodes and for what bridges hand to their robots.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ua_fleet.errors import FieldMissing
from ua_fleet.wire.messages import DataSetMetaData, FieldMetaData

__all__ = ["FieldOrder", "find_field"]


def find_field(announced: Sequence[FieldMetaData], name: str, path: str | None, *, is_only: bool) -> int | None:
    """Where in a DataSet's messages a field stands; None where they have none of that name.

    Args:
        announced: the fields of the DataSet, as its sender announces them.
        name: of the field in `fleet.yaml`.
        path: its place in the robot's message, by which a mirrored topic names it.
        is_only: whether `fleet.yaml` gives the DataSet this field alone; then a DataSet of one field is that.
    """
    if is_only and len(announced) == 1:
        return 0
    for wanted in (name, path):
        for index, field in enumerate(announced):
            if wanted is not None and field.name == wanted:
                return index
    return None


class FieldOrder:
    """Puts the values of a DataSet's messages into the order of `fleet.yaml`."""

    def __init__(self, label: str, fields: Sequence[tuple[str, str | None]]) -> None:
        """Make it for one DataSet.

        Args:
            label: how the DataSet is named in a line for people.
            fields: the name of each field, and its path where it has one.
        """
        self._label, self._fields = label, tuple(fields)
        self._metadata: DataSetMetaData | None = None
        self._places: tuple[int, ...] | None = ()
        """Where each field stands; None where each stands at its own place."""

    def arranged(self, metadata: DataSetMetaData, values: tuple[Any, ...]) -> tuple[Any, ...]:
        """The values of the fields, in their order; others are left out.

        Raises:
            FieldMissing: the messages have no such field, or not so many as they announce.
        """
        if metadata is not self._metadata:
            self._places = self._find(metadata)
            self._metadata = metadata
        if len(values) != len(metadata.fields):
            raise FieldMissing(
                f"{self._label}: {len(values)} values came, and {len(metadata.fields)} fields are announced"
            )
        return values if self._places is None else tuple([values[place] for place in self._places])

    def _find(self, metadata: DataSetMetaData) -> tuple[int, ...] | None:
        places: list[int] = []
        is_only = len(self._fields) == 1
        for name, path in self._fields:
            place = find_field(metadata.fields, name, path, is_only=is_only)
            if place is None:
                names = ", ".join(field.name for field in metadata.fields[:8])
                raise FieldMissing(f"{self._label}: its messages have no field {name!r}, but {names}")
            places.append(place)
        return None if places == list(range(len(metadata.fields))) else tuple(places)
