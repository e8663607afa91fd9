"""Commands as text, and what robots answer."""

from __future__ import annotations

import math
import time
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.bridge.templates import AnswerPattern, CommandTemplate, Language, TemplateInvalid
from ua_fleet.config.base import ScalarType
from ua_fleet.errors import SkillRejected

TYPES = {
    "angle": ScalarType.DOUBLE,
    "small": ScalarType.FLOAT,
    "count": ScalarType.INT32,
    "on": ScalarType.BOOLEAN,
    "text": ScalarType.STRING,
}


def rendered(template: str, language: Language = Language.PLAIN, /, **values: Any) -> str:
    return CommandTemplate(template, TYPES, language).render(values)


@pytest.mark.parametrize(
    ("template", "language", "values", "expected"),
    [
        ("movej([{angle}, {small:.2f}])\n", Language.URSCRIPT, {"angle": 0.1, "small": 1}, "movej([0.1, 1.00])\n"),
        ("a{{{count}}}b", Language.PLAIN, {"count": -3}, "a{-3}b"),
        ("N{count:04d}", Language.PLAIN, {"count": 7}, "N0007"),
        ("{angle:+.1e}", Language.PLAIN, {"angle": 1234.5}, "+1.2e+03"),
        ("{on},{on}", Language.URSCRIPT, {"on": True}, "True,True"),
        ("{on}", Language.RAPID, {"on": False}, "FALSE"),
        ("{on}", Language.C, {"on": True}, "true"),
        ("say {text}", Language.PLAIN, {"text": "a b"}, 'say "a b"'),
        ("say {text}", Language.PLAIN, {"text": None}, 'say ""'),
        ("load {text!w}", Language.PLAIN, {"text": "prog_1.urp"}, "load prog_1.urp"),
        ("TPWrite {text};", Language.RAPID, {"text": 'a"b\\'}, 'TPWrite "a""b\\\\";'),
        ("puts({text})", Language.C, {"text": 'a"b\\'}, 'puts("a\\"b\\\\")'),
        ("{text}", Language.URSCRIPT, {"text": "Grüße"}, '"Grüße"'),
        ("stop\n", Language.PLAIN, {}, "stop\n"),
    ],
)
def test_values_are_written_by_their_types(
    template: str, language: Language, values: dict[str, Any], expected: str
) -> None:
    assert rendered(template, language, **values) == expected


@pytest.mark.parametrize(
    ("template", "language", "values", "reason"),
    [
        ("{text}", Language.URSCRIPT, {"text": "a\nstopj(1)"}, "'\\\\n' cannot be sent"),
        ("{text}", Language.URSCRIPT, {"text": 'a"); stopj(1)'}, "urscript cannot write"),
        ("{text}", Language.KRL, {"text": '"'}, "krl cannot write"),
        ("{text}", Language.PLAIN, {"text": "\\"}, "plain cannot write"),
        ("{text}", Language.C, {"text": "a\x00"}, "cannot be sent"),
        ("{text}", Language.C, {"text": "a\u2028b"}, "cannot be sent"),
        ("{text}", Language.RAPID, {"text": "a" * 81}, "81 characters, and rapid takes 80"),
        ("{text!w}", Language.PLAIN, {"text": "a b"}, "no word"),
        ("{text!w}", Language.PLAIN, {"text": ""}, "no word"),
        ("{text!w}", Language.PLAIN, {"text": "a;b"}, "no word"),
        ("{angle}", Language.PLAIN, {"angle": math.nan}, "no number for a robot"),
        ("{angle:.3f}", Language.PLAIN, {"angle": -math.inf}, "no number for a robot"),
    ],
)
def test_what_a_language_cannot_write_is_refused(
    template: str, language: Language, values: dict[str, Any], reason: str
) -> None:
    with pytest.raises(SkillRejected, match=reason):
        rendered(template, language, **values)


@pytest.mark.parametrize(
    ("template", "reason"),
    [
        ("{angel}", "did you mean `angle`"),
        ("{}", "names nothing"),
        ("{angle", "write `{{` and `}}`"),
        ("{angle!r}", "only `!w`"),
        ("{angle!w}", "only a String"),
        ("{text:.3f}", "a String has no format"),
        ("{on:d}", "a Boolean has no format"),
        ("{angle:d}", "no format for a Double"),
        ("{count:.3f}", "no format for a Int32"),
        ("{count:.3}", "has no decimals"),
        ("{angle:>999999}", "no format"),
        ("{angle.real}", "is no argument"),
    ],
)
def test_a_template_that_cannot_be_used_is_told_at_once(template: str, reason: str) -> None:
    with pytest.raises(TemplateInvalid, match=reason):
        CommandTemplate(template, TYPES, Language.PLAIN)


@given(text=st.text(max_size=60), language=st.sampled_from(list(Language)))
def test_no_text_leaves_its_literal(text: str, language: Language) -> None:
    try:
        command = rendered("say({text})\n", language, text=text)
    except SkillRejected:
        return
    inner = command.removeprefix('say("').removesuffix('")\n')
    assert command == f'say("{inner}")\n'
    assert inner.isprintable()
    if language is Language.C:
        unescaped = inner.replace("\\\\", "").replace('\\"', "")
        assert "\\" not in unescaped
    elif language is Language.RAPID:
        unescaped = inner.replace('""', "")
    else:
        unescaped = inner
    assert '"' not in unescaped


@given(value=st.floats(allow_nan=False, allow_infinity=False))
def test_a_double_reads_the_same_again(value: float) -> None:
    line = rendered("AT {angle}", angle=value)
    assert AnswerPattern("AT {angle}", TYPES, Language.PLAIN).match(line) == {"angle": value}


@pytest.mark.parametrize(
    ("pattern", "language", "line", "expected"),
    [
        ("OK {angle} {count}", Language.PLAIN, "OK 1.5e1 -2", {"angle": 15.0, "count": -2}),
        ("OK {angle} {count}", Language.PLAIN, "OK 1.5 2.5", None),
        ("OK {angle} {count}", Language.PLAIN, "OK 1.5", None),
        ("OK", Language.PLAIN, "OK", {}),
        ("OK", Language.PLAIN, "OK ", None),
        ("{on}", Language.RAPID, "TRUE", {"on": True}),
        ("{on}", Language.RAPID, "true", None),
        ("ERR {text}", Language.PLAIN, "ERR it is stuck", {"text": "it is stuck"}),
        ("ERR {text}", Language.PLAIN, 'ERR "a ""b"""', {"text": 'a "b"'}),
        ("{text}, {count}", Language.PLAIN, "a b, 3", {"text": "a b", "count": 3}),
        ("{text!w} {count}", Language.PLAIN, "ab 3", {"text": "ab", "count": 3}),
        ("{angle}", Language.PLAIN, "1e999", None),
        ("{angle}", Language.PLAIN, "nan", None),
        ("(.*) {count}", Language.PLAIN, "abc 3", None),
    ],
)
def test_answers_are_read_by_their_types(
    pattern: str, language: Language, line: str, expected: dict[str, Any] | None
) -> None:
    assert AnswerPattern(pattern, TYPES, language).match(line) == expected


@pytest.mark.parametrize(
    ("pattern", "reason"),
    [
        ("{angle}{count}", "follows another placeholder"),
        ("{angle} {angle}", "twice"),
        ("{angle:.3f}", "has no format"),
        ("{other}", "is no result"),
    ],
)
def test_a_pattern_that_cannot_be_used_is_told_at_once(pattern: str, reason: str) -> None:
    with pytest.raises(TemplateInvalid, match=reason):
        AnswerPattern(pattern, TYPES, Language.PLAIN)


def test_a_hostile_line_costs_no_more_than_its_length() -> None:
    types = {f"t{index}": ScalarType.STRING for index in range(8)}
    pattern = AnswerPattern(" ".join(f"{{{name}}}" for name in types) + "!", types, Language.PLAIN)
    began = time.perf_counter()
    assert pattern.match(" " * 4096) is None
    assert pattern.match('"' * 4096) is None
    assert pattern.match("x" * 5000) is None
    assert time.perf_counter() - began < 1.0
