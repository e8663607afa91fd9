"""How an execution goes on, as a line."""

from __future__ import annotations

import fcntl
import io
import os
import pty
import struct
import termios

import pytest

from ua_fleet.cli.skill_progress import ProgressLine, SkillProgress, progress_text


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def known() -> SkillProgress:
    return SkillProgress("rover", "drive", "ab12", 30)


def test_what_is_told_of_another_execution_is_not_this_ones() -> None:
    skill = known()
    assert not skill.take("Progress", 0.9)
    skill.take("ExecutionId", "other")
    assert not skill.take("Progress", 0.9)
    skill.take("ExecutionId", "ab12")
    assert skill.take("Progress", 0.25)
    assert not skill.take("Progress", 0.25)
    assert skill.take("Message", "on the way")
    assert skill.take("CurrentState", "Suspended")
    assert (skill.progress, skill.message, skill.state) == (0.25, "on the way", "Suspended")


def test_the_line_says_how_far_it_is_and_since_when() -> None:
    skill = known()
    assert progress_text(skill, 2.04, with_bar=True) == "rover.drive  Running  2.0 s of at most 30.0 s"
    skill.take("ExecutionId", "ab12")
    skill.take("Progress", 0.5)
    skill.take("Message", "to store")
    assert (
        progress_text(skill, 65, with_bar=True)
        == "rover.drive  Running  [##########..........]  50%  1 min 5 s of at most 30.0 s  to store"
    )
    assert progress_text(skill, 1, with_bar=False).split("  ")[2] == "50%"
    skill.take("Progress", 7.0)
    assert "100%" in progress_text(skill, 1, with_bar=True)


def test_a_terminal_has_one_line_that_is_taken_away_at_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "20")
    monkeypatch.setenv("TERM", "xterm")
    stream = Terminal()
    line = ProgressLine(stream)
    line.show("a" * 30, is_change=False)
    line.show("b\x1b[2J", is_change=True)
    line.end()
    line.end()
    assert stream.getvalue() == f"\r\x1b[K{'a' * 18}…\r\x1b[Kb\\x1b[2J\r\x1b[K"


def test_the_line_is_as_wide_as_the_terminal_that_has_it_wherever_stdout_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    monkeypatch.setenv("TERM", "xterm")
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 40, 0, 0))
    with os.fdopen(theirs, "w") as stream:
        ProgressLine(stream).show("a" * 300, is_change=False)
        said = os.read(ours, 1000).decode()
    os.close(ours)
    assert said == f"\r\x1b[K{'a' * 38}…"


def test_without_a_terminal_there_is_a_line_for_each_change() -> None:
    stream = io.StringIO()
    line = ProgressLine(stream)
    line.show("first", is_change=True)
    line.show("later", is_change=False)
    line.show("last", is_change=True)
    line.end()
    assert stream.getvalue() == "first\nlast\n"
