"""The table of `docs/testbed.md`, from what was seen. Pure but for writing it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Final

from tests.testbed.disturb import ABSENCE_S, Deed
from tests.testbed.healing import LIMIT_S, Row
from tests.testbed.ledger import Account

__all__ = ["failures", "into_page", "lines", "write_json"]

BEGIN: Final = "<!-- {} -->"
END: Final = "<!-- /{} -->"
"""Around the table of a profile."""


def lines(rows: Sequence[Row], about: Mapping[str, str]) -> list[str]:
    """The table in Markdown.

    Args:
        rows: in the order of the run.
        about: of the machine and the run, for the line above it.
    """
    head = ", ".join(f"{name} {value}" for name, value in about.items())
    total = sum((row.account for row in rows), Account())
    made = [
        head + ".",
        "",
        "| what | | noticed | healed | commands | done | refused | failed | unknown | lost | doubled | late | gaps |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    made += [_line(row) for row in rows]
    sums = (
        *(total.asked, total.done, total.refused, total.failed),
        *(total.unknown + total.unanswered, total.lost, total.doubled, total.late),
    )
    made.append("| **all** | | | | " + " | ".join(f"**{number}**" for number in sums) + " | |")
    return made


def _line(row: Row) -> str:
    what = row.account
    cells = (
        f"{row.kind} (`{row.service}`)",
        row.deed if row.deed == Deed.KILL else f"{row.deed} {ABSENCE_S:g} s",
        "-" if row.noticed_s is None else f"{row.noticed_s:.1f} s",
        f"**not in {LIMIT_S:g} s**" if row.healed_s is None else f"{row.healed_s:.1f} s",
        *map(str, (what.asked, what.done, what.refused, what.failed, what.unknown + what.unanswered)),
        *(str(what.lost), str(what.doubled), str(what.late), "-" if row.gaps is None else str(row.gaps)),
    )
    return f"| {' | '.join(cells)} |"


def failures(rows: Sequence[Row]) -> list[str]:
    """What is not as it has to be, one line each."""
    found: list[str] = []
    for row in rows:
        what = f"{row.service} {row.deed}"
        if row.healed_s is None:
            found.append(f"{what}: not well after {LIMIT_S:g} s: {'; '.join(row.missing)}")
        if row.account.lost:
            found.append(f"{what}: {row.account.lost} commands lost")
        if row.account.doubled:
            found.append(f"{what}: {row.account.doubled} commands doubled")
        if row.account.late:
            found.append(f"{what}: {row.account.late} commands begun too late")
        found += [f"{what}: {problem}" for problem in row.meanwhile]
        if row.account.asked == 0:
            found.append(f"{what}: nothing was asked for meanwhile")
    return found


def into_page(page: str, profile: str, table: Sequence[str]) -> str:
    """A page with another table between the marks of a profile; raises ValueError where it has none."""
    first, last = BEGIN.format(profile), END.format(profile)
    before, begin, rest = page.partition(first)
    _, end, after = rest.partition(last)
    if not begin or not end:
        raise ValueError(f"there is no {first} with {last} after it")
    return "\n".join((f"{before}{begin}", *table, f"{end}{after}"))


def write_json(path: Path, rows: Sequence[Row], about: Mapping[str, str]) -> None:
    """Write all that was seen for programs."""
    path.parent.mkdir(parents=True, exist_ok=True)
    made = {"about": dict(about), "rows": [asdict(row) for row in rows]}
    path.write_text(json.dumps(made, indent=2) + "\n", encoding="utf-8")
