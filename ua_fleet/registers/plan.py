"""Which requests read, or write, a set of values. Pure.

Values side by side are read in one request, as long as a request may be; what lies between two of them is read along
where that is no farther than `most_gap`, and only where the device is known to have those addresses. A value is never
cut in two: its halves could come from two moments. The first value that no longer fits begins the next request, which
for values on a line gives the fewest requests there can be.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from ua_fleet.registers.model import LAST_ADDRESS, AddressSpan, Table

__all__ = ["DeviceLimits", "fits_device", "plan_reads"]


@dataclass(frozen=True, slots=True)
class DeviceLimits:
    """What a device takes in one request, and which addresses it has."""

    read_words: int = 125
    read_bits: int = 2000
    write_words: int = 123
    write_bits: int = 1968
    most_gap: int = 16
    """Addresses that nobody asked for and that are read along."""
    ranges: Mapping[Table, Sequence[tuple[int, int]]] = field(default_factory=dict[Table, Sequence[tuple[int, int]]])
    """First and last addresses of what each table has; a table that is not named has them all, but none is known."""

    def most_read(self, table: Table) -> int:
        """Addresses of a table that one request may read."""
        return self.read_bits if table.is_bits else self.read_words

    def most_written(self, table: Table) -> int:
        """Addresses of a table that one request may write."""
        return self.write_bits if table.is_bits else self.write_words


def _known(limits: DeviceLimits, span: AddressSpan) -> bool:
    """Whether the device says that it has all of these addresses."""
    return any(first <= span.address and span.end - 1 <= last for first, last in limits.ranges.get(span.table, ()))


def fits_device(limits: DeviceLimits, span: AddressSpan) -> bool:
    """Whether a device has these addresses, as far as it says."""
    return span.end - 1 <= LAST_ADDRESS and (span.table not in limits.ranges or _known(limits, span))


def plan_reads(spans: Iterable[AddressSpan], limits: DeviceLimits) -> tuple[AddressSpan, ...]:
    """The requests that read all of these, by table and address. Each of `spans` lies within one of them."""
    requests: list[AddressSpan] = []
    for span in sorted(set(spans), key=lambda span: (span.table.value, span.address, span.count)):
        last = requests[-1] if requests else None
        if last is not None and last.table is span.table:
            joined = AddressSpan(last.table, last.address, max(last.end, span.end) - last.address)
            gap = span.address - last.end
            is_near = gap <= 0 or (gap <= limits.most_gap and _known(limits, joined))
            if is_near and joined.count <= limits.most_read(span.table):
                requests[-1] = joined
                continue
        requests.append(span)
    return tuple(requests)
