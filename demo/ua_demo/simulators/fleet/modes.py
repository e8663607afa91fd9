"""Both modes of a run beside each other, and beside the paper: what they cost, and what each needs.

`python -m ua_demo.simulators.fleet.modes docs/simulator.md` writes the table of that page anew.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Final

from ua_demo import equations
from ua_demo.equations import equation_12_sum
from ua_demo.simulators.fleet.fleet import Settings
from ua_demo.simulators.fleet.report import situation_of
from ua_demo.simulators.fleet.run import Result, simulate
from ua_fleet.config.reference import show_or_put
from ua_fleet.traffic import MessageKind

__all__ = ["BEGIN", "END", "PAGE_SETTINGS", "both_modes", "markdown", "modes_table"]

BEGIN: Final = "<!-- modes: made by `python -m ua_demo.simulators.fleet.modes docs/simulator.md` -->"
END: Final = "<!-- end of the modes -->"
PAGE_SETTINGS: Final = Settings(50, 100)
_TASK_KINDS: Final = (MessageKind.REQUEST, MessageKind.RESPONSE, MessageKind.STATUS)


def both_modes(settings: Settings, known: Result | None = None) -> tuple[Result, Result]:
    """The same fleet and tasks orchestrated and carried; one of both may be known already."""
    results = [
        known
        if known is not None and known.settings.carried == carried
        else simulate(replace(settings, carried=carried))
        for carried in (False, True)
    ]
    return results[0], results[1]


def modes_table(orchestrated: Result, carried: Result) -> list[list[str]]:
    """Rows for people, with their heads."""
    situation = situation_of(orchestrated.settings)
    registration = equations.boot(situation.robots) + equations.identification(situation.robots)
    tasks, tokens = equations.task(situation), equations.forward(situation)
    fails = equations.fail(situation.faulty_robots)
    results = (orchestrated, carried)

    def counted(*kinds: MessageKind) -> list[str]:
        return [
            f"{sum(each.traffic.messages[kind] for kind in kinds):,}; "
            f"{sum(each.traffic.bytes[kind] for kind in kinds):,} bytes"
            for each in results
        ]

    rows = [
        ["", "orchestrated", "carried", "TalkRoBots"],
        ["registration", *counted(MessageKind.REGISTRATION), f"{registration:,} (Eq. 1, 2)"],
        ["request, response, status", *counted(*_TASK_KINDS), f"{tasks:,} (Eq. 7)"],
        ["token: parts, tokens, ends", *counted(MessageKind.TOKEN), f"{tokens:,} (Eq. 8)"],
        ["fault", *counted(MessageKind.FAULT), f"{fails:,} (Eq. 11)"],
        [
            "together",
            *(
                f"{equation_12_sum(each.traffic.messages):,}; {equation_12_sum(each.traffic.bytes):,} bytes"
                for each in results
            ),
            f"{equations.total(situation):,.0f} (Eq. 12)",
        ],
        ["beside them: run, for who watches", *counted(MessageKind.RUN), "-"],
        ["the run takes", *(f"{each.ended_s - each.began_s:.2f} s" for each in results), "-"],
        ["needs the server", "for each task", "for the start", "for a fault (Eq. 11)"],
        ["needs of the bridges", "that the server may command them", "that those before and behind may", "-"],
    ]
    for column in range(len(rows[0]) - 1):
        width = max(len(row[column]) for row in rows)
        for row in rows:
            row[column] = row[column].ljust(width)
    return rows


def markdown() -> str:
    """The table of the page."""
    rows = [[cell.strip() for cell in row] for row in modes_table(*both_modes(PAGE_SETTINGS))]
    lines = [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join([lines[0].replace("|  |", "| |", 1), "|---|---:|---:|---:|", *lines[1:]])


if __name__ == "__main__":
    show_or_put(sys.argv[1:], markdown(), BEGIN, END)
