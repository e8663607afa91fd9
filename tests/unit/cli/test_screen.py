"""When there are colours, and what is drawn."""

from __future__ import annotations

import io

import pytest

from ua_fleet.cli.screen import ColorWhen, Screen, has_colours


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("when", "no_color", "term", "stream", "expected"),
    [
        (ColorWhen.AUTO, None, "xterm", Terminal(), True),
        (ColorWhen.AUTO, "", "xterm", Terminal(), True),
        (ColorWhen.AUTO, "1", "xterm", Terminal(), False),
        (ColorWhen.AUTO, None, "dumb", Terminal(), False),
        (ColorWhen.AUTO, None, "xterm", io.StringIO(), False),
        (ColorWhen.ALWAYS, "1", "dumb", io.StringIO(), True),
        (ColorWhen.NEVER, None, "xterm", Terminal(), False),
    ],
)
def test_colours(
    when: ColorWhen,
    no_color: str | None,
    term: str,
    stream: io.StringIO,
    expected: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    if no_color is not None:
        monkeypatch.setenv("NO_COLOR", no_color)
    monkeypatch.setenv("TERM", term)
    assert has_colours(when, stream) is expected


def test_pictures_follow_each_other_where_there_is_no_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    screen = Screen(is_live=False)
    screen.begin()
    screen.show(["a", "b"])
    screen.show(["c"])
    screen.end()
    assert capsys.readouterr().out == "a\nb\n\nc\n\n"


def test_a_picture_that_is_too_high_says_so_and_is_whole_at_the_end(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LINES", "4")
    monkeypatch.setenv("COLUMNS", "80")
    screen = Screen(is_live=True)
    lines = [f"line {number}" for number in range(6)]
    screen.begin()
    screen.show(lines)
    drawn = capsys.readouterr().out
    assert "line 2" in drawn
    assert "line 3" not in drawn
    assert "… 3 more lines" in drawn
    screen.end()
    ended = capsys.readouterr().out
    assert ended.endswith("\x1b[?1049l" + "".join(f"{line}\n" for line in lines))


def test_lines_that_are_too_wide_are_cut_by_the_terminal_and_take_no_other_lines_place(
    capsys: pytest.CaptureFixture[str],
) -> None:
    screen = Screen(is_live=True)
    screen.begin()
    assert "\x1b[?7l" in capsys.readouterr().out
    screen.show(["x" * 1000])
    screen.end()
    assert "\x1b[?7h" in capsys.readouterr().out.partition("\x1b[?1049l")[0]
