"""Whether an audit log is whole: the chain of its lines over all files, the oldest first.

What is found: a line that was changed, removed, inserted or moved, in whichever file; a file that is missing, also the
oldest, which no line `rotation` has announced; and lines missing at the end, as far as `audit.head` or an anchor that
was noted elsewhere knows them. What cannot be found: somebody who may write the folder and makes all hashes, and
`audit.head`, anew. An anchor or the copy of a syslog server shows that.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from ua_fleet.endpoint.audit.chain import BEGIN, ChainLink, digest_of, link_of, parse_line
from ua_fleet.endpoint.audit.chained_file import HEAD_FILE, log_files, read_head
from ua_fleet.errors import UaFleetError
from ua_fleet.values import StatusCode

__all__ = ["AuditLogMissing", "ChainCheck", "ChainProblem", "ChainReport", "verify"]

MAX_PROBLEMS: Final = 100
"""Problems that are told one by one; the rest is counted."""

MAX_TRIES: Final = 5


class AuditLogMissing(UaFleetError):
    """There is no audit log, or it cannot be read."""

    ua_status = StatusCode.BAD_CONFIGURATION_ERROR
    remedy = "Name the `state_dir` of the server whose log is meant, as a user who may read it."


@dataclass(frozen=True, slots=True)
class ChainProblem:
    """Something that should not be."""

    file: str
    line: int
    """In the file, from 1; 0 for the file as a whole."""
    text: str


@dataclass(slots=True)
class ChainReport:
    """What was found."""

    files: int = 0
    lines: int = 0
    """Chained lines."""
    unchained: int = 0
    """Lines of an older version, before the chain."""
    first: int = 0
    last: ChainLink = BEGIN
    """Number and hash of the last line: note them elsewhere, as an anchor."""
    problems: list[ChainProblem] = field(default_factory=list[ChainProblem])
    more_problems: int = 0
    notes: list[str] = field(default_factory=list[str])

    @property
    def whole(self) -> bool:
        """Whether nothing was found."""
        return not self.problems


class ChainCheck:
    """Follows a chain line by line; pure."""

    def __init__(self, head: ChainLink | None, anchors: Sequence[ChainLink] = ()) -> None:
        self.report = ChainReport()
        self._head = head
        self._anchors = {anchor.seq: anchor.digest for anchor in anchors}
        self._before: ChainLink | None = None
        self._first: ChainLink | None = None
        self._removed_to = -1
        self._seen_head = False
        self._place = ("", 0)

    def _problem(self, text: str, file: str | None = None, line: int = 0) -> None:
        report = self.report
        if len(report.problems) >= MAX_PROBLEMS:
            report.more_problems += 1
            return
        place = self._place if file is None else (file, line)
        report.problems.append(ChainProblem(*place, text))

    def file(self, name: str, lines: Iterable[bytes], *, newest: bool) -> None:
        """The next file, with its newlines; the last line of the newest may be incomplete."""
        self.report.files += 1
        for number, line in enumerate(lines, 1):
            self._place = (name, number)
            if line.endswith(b"\n"):
                self._line(line[:-1])
            elif newest:
                note = f"{name}:{number}: incomplete line; the server was ended in it, or is writing it"
                self.report.notes.append(note)
            else:
                self._problem("the line is cut off")

    def _line(self, line: bytes) -> None:
        record = parse_line(line)
        link = link_of(record) if record is not None else None
        digest = digest_of(line)
        before = self._before
        if record is None or link is None:
            if before is not None and self._first is not None:
                self._problem("no line of the chain (it has no number)" if record is not None else "no JSON")
            elif record is None:
                self._problem("no JSON")
            else:
                self.report.unchained += 1
            self._before = ChainLink(before.seq if before is not None else 0, digest)
            return
        self.report.lines += 1
        if self._first is None:
            self._first = link
            self.report.first = link.seq
            if before is not None and link.digest != before.digest:
                self._problem("the line before the chain was changed or removed")
        elif before is not None:
            self._follow(before, link)
        self._note(record)
        self._before = self.report.last = ChainLink(link.seq, digest)
        self._hold_against(link.seq, digest)

    def _follow(self, before: ChainLink, link: ChainLink) -> None:
        if link.seq > before.seq + 1:
            gone = (
                f"line {before.seq + 1} is"
                if link.seq == before.seq + 2
                else f"lines {before.seq + 1} to {link.seq - 1} are"
            )
            self._problem(f"{gone} missing before this one (number {link.seq})")
        elif link.seq <= before.seq:
            self._problem(f"number {link.seq} comes after number {before.seq}: a line was inserted or moved")
        elif link.digest != before.digest:
            self._problem(f"the line before this one (number {before.seq}) was changed")

    def _note(self, record: dict[str, object]) -> None:
        event, time = record.get("event"), record.get("time")
        removed_to = record.get("removed_to")
        if event == "rotation" and isinstance(removed_to, int):
            self._removed_to = max(self._removed_to, removed_to)
        elif event == "lost":
            self.report.notes.append(f"{time}: {record.get('lines')} lines could not be written (full disk?)")
        elif event == "recovered":
            self.report.notes.append(f"{time}: the server was ended while it wrote a line, which was cut off")
        elif event == "missing" and "reason" in record:
            self._problem(f"at its start the server found: {record['reason']}")

    def _hold_against(self, seq: int, digest: str) -> None:
        if self._head is not None and seq == self._head.seq:
            self._seen_head = True
            if digest != self._head.digest:
                self._problem(f"the line (number {seq}) is not the one that {HEAD_FILE} knows")
        expected = self._anchors.pop(seq, None)
        if expected is not None and not digest.startswith(expected):
            self._problem(f"the line (number {seq}) is not the one of the anchor")

    def end(self) -> ChainReport:
        """There are no more files: what is known of the whole."""
        first, last, name = self._first, self.report.last, self._place[0]
        if first is not None:
            self._check_begin(first)
        if self._head is None:
            if first is not None:
                self._problem("is not there or damaged: whether the end of the log is whole cannot be said", HEAD_FILE)
        elif last.seq < self._head.seq:
            gone = self._head.seq - last.seq
            self._problem(f"{gone} line(s) are missing at the end, up to number {self._head.seq}", name)
        for seq in sorted(self._anchors):
            if first is None or seq > last.seq:
                self._problem(f"number {seq}, the anchor's, is missing at the end", name)
            elif seq < first.seq:
                self.report.notes.append(f"number {seq}, the anchor's, is older than the files")
        return self.report

    def _check_begin(self, first: ChainLink) -> None:
        if first.seq == 1 and (first.digest == BEGIN.digest or self.report.unchained):
            return
        if first.seq - 1 > self._removed_to:
            self._problem(f"lines up to number {first.seq - 1} are missing, and no rotation removed them", "", 0)


def verify(path: Path, anchors: Sequence[ChainLink] = ()) -> ChainReport:
    """Read and check the files of a log; raises AuditLogMissing.

    Args:
        path: of the newest file.
        anchors: numbers and hashes, or their first digits, that were noted elsewhere.
    """
    tries = 0
    while True:
        before = _names(path)
        report = _verify(path, anchors)
        tries += 1
        if report.whole or _names(path) == before or tries == MAX_TRIES:
            return report


def _names(path: Path) -> list[tuple[str, int]]:
    """Which file has which name: they change when the server begins a new file."""
    try:
        return [(file.name, file.stat().st_ino) for file in log_files(path)]
    except OSError:
        return []


def _verify(path: Path, anchors: Sequence[ChainLink]) -> ChainReport:
    head = read_head(path)  # before the lines: what it knows is in the files by then
    files = log_files(path)
    if not files and head is None:
        raise AuditLogMissing(f"{path}: there is no audit log; is this the server's machine and state_dir?")
    check = ChainCheck(head, anchors)
    try:
        for file in files:
            check.file(file.name, _lines(file), newest=file == path)
    except OSError as error:
        raise AuditLogMissing(f"{path}: cannot be read ({error.strerror}); run this as the server's user") from error
    return check.end()


def _lines(path: Path) -> Iterator[bytes]:
    with path.open("rb") as file:
        yield from file
