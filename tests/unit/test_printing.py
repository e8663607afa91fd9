from __future__ import annotations

import json
import unicodedata

from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.printing import harmless, harmless_json, harmless_lines

OBEYED = {"Cc", "Cf", "Cs", "Zl", "Zp"}
"""Categories of Unicode: controls, formats (among them the marks of direction), surrogates, ends of lines."""


@given(st.text())
def test_nothing_that_a_terminal_obeys_is_left(text: str) -> None:
    assert not {unicodedata.category(char) for char in harmless(text)} & OBEYED
    assert not {unicodedata.category(char) for char in harmless_lines(text).replace("\n", "")} & OBEYED


@given(st.text())
def test_json_is_harmless_and_means_the_same(text: str) -> None:
    shown = harmless_json({"name": text})
    assert not {unicodedata.category(char) for char in shown} & OBEYED
    assert json.loads(shown) == {"name": text}


def test_what_people_read_stays() -> None:
    assert harmless("Ärm 7 in Köln, 工場, 21 °C") == "Ärm 7 in Köln, 工場, 21 °C"
    assert harmless("é\x1b[2J\x9b\n\u202e") == "é\\x1b[2J\\x9b\\n\\u202e"
    assert harmless_lines("one\ntwo\x1b") == "one\ntwo\\x1b"
