"""`ua-fleet audit`: the server's audit log."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ua_fleet.cli.endings import EXIT_FAILED, UsageError
from ua_fleet.cli.options import DEFAULT_CONFIG, Config, Json, state_folder
from ua_fleet.cli.output import message, print_json, print_line

if TYPE_CHECKING:
    from ua_fleet.endpoint.audit.chain import ChainLink
    from ua_fleet.endpoint.audit.verification import ChainReport

__all__ = ["VERIFY_EXAMPLES", "verify"]

VERIFY_EXAMPLES = (
    "ua-fleet audit verify",
    "ua-fleet audit verify --anchor 1842:9f3a5b27c04d",
    "ua-fleet audit verify --file /backup/audit.log --json",
)
MIN_DIGITS = 8
"""Of an anchor's hash."""


def _anchor(text: str) -> ChainLink:
    from ua_fleet.endpoint.audit.chain import ChainLink

    number, _, digest = text.partition(":")
    digest = digest.lower()
    if not number.isdecimal() or len(digest) < MIN_DIGITS or set(digest) - set("0123456789abcdef"):
        raise UsageError(f"{text!r} is no anchor; write NUMBER:HASH, as `ua-fleet audit verify` printed it")
    return ChainLink(int(number), digest)


def verify(
    anchor: Annotated[
        list[str] | None,
        typer.Option(metavar="NUMBER:HASH", help="A line that the log must contain, as an earlier verify printed it."),
    ] = None,
    file: Annotated[
        Path | None, typer.Option(help="Check a copy of a log instead of the server's log; give its newest file.")
    ] = None,
    config: Config = DEFAULT_CONFIG,
    as_json: Json = False,
) -> None:
    """Check the audit log: that no line was changed, removed or inserted since the server wrote it.

    The command prints the last line's number and hash. Note them elsewhere: given as an anchor later, they also reveal
    a log that was replaced as a whole. The exit code is 1 if a line is wrong; the message names the line.
    """
    from ua_fleet.endpoint.audit.log import LOG_FILE
    from ua_fleet.endpoint.audit.verification import verify as verify_log

    anchors = [_anchor(text) for text in anchor or []]
    path = file if file is not None else state_folder(config)[1] / LOG_FILE
    report = verify_log(path, anchors)
    if as_json:
        print_json({**asdict(report), "whole": report.whole})
    else:
        _print(path, report)
    if not report.whole:
        raise typer.Exit(EXIT_FAILED)


def _print(path: Path, report: ChainReport) -> None:
    for problem in report.problems:
        place = "".join((problem.file, f":{problem.line}" if problem.line else ""))
        print_line(f"{path.parent / place if place else path}: {problem.text}")
    if report.more_problems:
        print_line(f"and {report.more_problems} more")
    for note in report.notes:
        message(note)
    if report.unchained:
        message(f"{report.unchained} lines of an older version are not chained, and not checked")
    if report.whole:
        what = f"{report.lines} lines in {report.files} files, none changed, none missing"
        print_line(f"{what}; last: {report.last.seq}:{report.last.digest}")
