"""Commands for robots that take text, and what they answer. Pure.

A command is a text with placeholders, `movej([{j1:.4f}, {j2:.4f}], a={a})`; an answer has the same form,
`OK {distance}`. `{{` and `}}` are braces. A placeholder names an argument (of a command) or a result (of an answer),
whose type says how it is written and read:

    Boolean    the language's words
    integers   decimal; `:` gives a format, `{count:04d}`
    floats     the shortest decimal that reads the same; `{angle:.3f}`; NaN and infinity are refused
    String     a literal in the language's quotes, `{text}`, or a bare word, `{name!w}`, of letters, digits and `_-.:/`

Nothing in a value can end its literal: what the language cannot write inside one is refused, and so is every control
character. So an argument never becomes a second command.
"""

from __future__ import annotations

import math
import re
import string
from collections.abc import Mapping
from enum import StrEnum
from typing import Any, Final, NamedTuple

from ua_fleet.config.base import ScalarType
from ua_fleet.errors import SkillRejected
from ua_fleet.names import closest

__all__ = ["AnswerPattern", "CommandTemplate", "Language", "TemplateInvalid"]


class TemplateInvalid(ValueError):
    """A template that cannot be used; the text says why and what to do."""


class Language(StrEnum):
    """The language in which a robot takes its commands."""

    PLAIN = "plain"
    """A line protocol: `true`, `false`; quotes and backslashes cannot stand in a literal."""
    URSCRIPT = "urscript"
    """`True`, `False`; quotes cannot stand in a literal, for which URScript has no escape."""
    RAPID = "rapid"
    """`TRUE`, `FALSE`; quotes and backslashes are doubled, at most 80 characters in a literal."""
    KRL = "krl"
    """`TRUE`, `FALSE`; quotes cannot stand in a literal, for which KRL has no escape."""
    C = "c"
    """`true`, `false`; quotes and backslashes get a backslash."""


class _Writing(NamedTuple):
    false: str
    true: str
    refused: str
    """Characters that cannot stand in a literal."""
    escapes: Mapping[str, str]
    longest: int


_WRITING: Final[Mapping[Language, _Writing]] = {
    Language.PLAIN: _Writing("false", "true", '"\\', {}, 4096),
    Language.URSCRIPT: _Writing("False", "True", '"', {}, 4096),
    Language.RAPID: _Writing("FALSE", "TRUE", "", {'"': '""', "\\": "\\\\"}, 80),
    Language.KRL: _Writing("FALSE", "TRUE", '"', {}, 470),
    Language.C: _Writing("false", "true", "", {'"': '\\"', "\\": "\\\\"}, 4096),
}
_FLOATS: Final = (ScalarType.FLOAT, ScalarType.DOUBLE)
_TEXTS: Final = (ScalarType.STRING,)
_WORD: Final = re.compile(r"[A-Za-z0-9_.:/-]{1,255}")
_FORMAT: Final = re.compile(r"[+ ]?0?[0-9]{0,2}(\.[0-9]{1,2})?[defg]?")
_NUMBER: Final = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?"
_INTEGER: Final = r"[+-]?\d{1,20}"
_LONGEST_ANSWER: Final = 4096


class _Place(NamedTuple):
    before: str
    """The literal text before it."""
    name: str
    format: str
    is_word: bool


def _places(text: str) -> tuple[tuple[_Place, ...], str]:
    """The placeholders of a template, and the text after the last."""
    places: list[_Place] = []
    before = ""
    try:
        for literal, name, form, conversion in string.Formatter().parse(text):
            before += literal
            if name is None:
                continue
            if not name:
                raise TemplateInvalid("`{}` names nothing; write the argument's name into it, or `{{}}` for braces")
            if conversion not in (None, "w"):
                raise TemplateInvalid(f"{{{name}!{conversion}}}: only `!w`, a bare word, is known")
            places.append(_Place(before, name, form or "", conversion == "w"))
            before = ""
    except ValueError as error:
        if isinstance(error, TemplateInvalid):
            raise
        raise TemplateInvalid(f"{error}; write `{{{{` and `}}}}` for braces that are no placeholder") from error
    return tuple(places), before


def _text_before(ends: str) -> str:
    """A quoted text, or all up to `ends`. Atomic, so that no line takes more than one look at each character.

    Not by possessive quantifiers of groups: before Python 3.11.5 they match less than they should.
    """
    bare = f"(?>(?:(?!{re.escape(ends)}).)*)" if ends else "(?>.*)"
    return f'(?>"(?:[^"]|"")*")|{bare}'


def _type_of(place: _Place, known: Mapping[str, ScalarType], what: str) -> ScalarType:
    kind = known.get(place.name)
    if kind is None:
        there = closest(place.name, known) or (f"there are: {', '.join(known)}" if known else f"it has no {what}s")
        raise TemplateInvalid(f"{{{place.name}}} is no {what} of the skill; {there}")
    if place.is_word and kind not in _TEXTS:
        raise TemplateInvalid(f"{{{place.name}!w}}: only a String is a bare word, and it is a {kind.value}")
    return kind


class CommandTemplate:
    """A command with places for typed values."""

    def __init__(self, text: str, arguments: Mapping[str, ScalarType], language: Language) -> None:
        """`arguments` are those that the template may name.

        Raises:
            TemplateInvalid: a placeholder without such an argument, or with a format that its type does not have.
        """
        self._places, self._after = _places(text)
        self._types = tuple([_type_of(place, arguments, "argument") for place in self._places])
        self._language, self._writing = language, _WRITING[language]
        for place, kind in zip(self._places, self._types, strict=True):
            self._check_format(place, kind)

    @property
    def names(self) -> frozenset[str]:
        """The arguments that it names."""
        return frozenset(place.name for place in self._places)

    @staticmethod
    def _check_format(place: _Place, kind: ScalarType) -> None:
        if not place.format:
            return
        if kind in (*_TEXTS, ScalarType.BOOLEAN):
            raise TemplateInvalid(f"{{{place.name}:{place.format}}}: a {kind.value} has no format")
        is_float = kind in _FLOATS
        ends = place.format[-1]
        if _FORMAT.fullmatch(place.format) is None or (is_float and ends == "d") or (not is_float and ends in "efg."):
            raise TemplateInvalid(
                f"{{{place.name}:{place.format}}} is no format for a {kind.value}; e.g. {'.3f' if is_float else '04d'}"
            )
        if not is_float and "." in place.format:
            raise TemplateInvalid(f"{{{place.name}:{place.format}}}: a {kind.value} has no decimals; e.g. 04d")

    def render(self, values: Mapping[str, Any]) -> str:
        """The command with values in it.

        Raises:
            SkillRejected: a value that cannot be written; the robot gets nothing.
        """
        parts: list[str] = []
        for place, kind in zip(self._places, self._types, strict=True):
            parts.append(place.before)
            parts.append(self._write(place, kind, values[place.name]))
        parts.append(self._after)
        return "".join(parts)

    def _write(self, place: _Place, kind: ScalarType, value: Any) -> str:
        if kind is ScalarType.BOOLEAN:
            return self._writing.true if value else self._writing.false
        if kind in _TEXTS:
            return self._word(place.name, value) if place.is_word else self._literal(place.name, value)
        if kind in _FLOATS:
            number = float(value)
            if not math.isfinite(number):
                raise SkillRejected(f"{place.name}: {number} is no number for a robot")
            return format(number, place.format) if place.format else repr(number)
        return format(int(value), place.format)

    def _word(self, name: str, value: Any) -> str:
        text = str(value or "")
        if _WORD.fullmatch(text) is None:
            raise SkillRejected(f"{name}: {text[:40]!r} is no word of letters, digits and _-.:/")
        return text

    def _literal(self, name: str, value: Any) -> str:
        text, writing = str(value or ""), self._writing
        for character in text:
            if not character.isprintable():
                raise SkillRejected(f"{name}: {character!r} cannot be sent to the robot; give printable text")
            if character in writing.refused:
                raise SkillRejected(f"{name}: {self._language.value} cannot write {character} in a text; leave it out")
        if len(text) > writing.longest:
            raise SkillRejected(f"{name}: {len(text)} characters, and {self._language.value} takes {writing.longest}")
        return '"' + "".join([writing.escapes.get(character, character) for character in text]) + '"'


class AnswerPattern:
    """A line that a robot says, with places for typed values. A String takes what stands there, quoted or not."""

    def __init__(self, text: str, results: Mapping[str, ScalarType], language: Language) -> None:
        """`results` are those that the pattern may name.

        Raises:
            TemplateInvalid: a placeholder without such a result, with a format, twice, or beside another.
        """
        places, after = _places(text)
        self._types: dict[str, ScalarType] = {}
        self._language = language
        words = _WRITING[language]
        whole = ""
        for index, place in enumerate(places):
            kind = _type_of(place, results, "result")
            if place.format:
                raise TemplateInvalid(f"{{{place.name}:{place.format}}}: what a robot answers has no format")
            if place.name in self._types:
                raise TemplateInvalid(f"{{{place.name}}} stands there twice")
            if index and not place.before:
                raise TemplateInvalid(f"{{{place.name}}} follows another placeholder: put something between them")
            self._types[place.name] = kind
            if kind in _TEXTS:
                ends = places[index + 1].before if index + 1 < len(places) else after
                pattern = _WORD.pattern if place.is_word else _text_before(ends)
            elif kind is ScalarType.BOOLEAN:
                pattern = f"{words.true}|{words.false}"
            else:
                pattern = _NUMBER if kind in _FLOATS else _INTEGER
            whole += f"{re.escape(place.before)}({pattern})"
        self._pattern = re.compile(whole + re.escape(after))

    @property
    def names(self) -> frozenset[str]:
        """The results that it names."""
        return frozenset(self._types)

    def match(self, line: str) -> dict[str, Any] | None:
        """The values of a line, None where it is another line."""
        if len(line) > _LONGEST_ANSWER:
            return None
        found = self._pattern.fullmatch(line)
        if found is None:
            return None
        told = zip(self._types.items(), found.groups(), strict=True)
        values = {name: self._read(kind, text) for (name, kind), text in told}
        return None if any(isinstance(value, float) and math.isinf(value) for value in values.values()) else values

    def _read(self, kind: ScalarType, text: str) -> Any:
        if kind is ScalarType.BOOLEAN:
            return text == _WRITING[self._language].true
        if kind is ScalarType.STRING:
            return text[1:-1].replace('""', '"') if len(text) > 1 and text[0] == text[-1] == '"' else text
        return float(text) if kind in _FLOATS else int(text)
