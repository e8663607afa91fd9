from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.document import MAX_BYTES, read_document, resolve_scalar

UNREADABLE: list[tuple[str, bytes, str]] = [
    ("empty", b"", "f.yaml: is empty"),
    ("only comments", b"# nothing\n", "f.yaml: is empty"),
    ("a list", b"- a\n", "f.yaml:1: must have keys like `version: 1`"),
    (
        "a tab",
        b"a:\n\tb: 1\n",
        "f.yaml:2: is not YAML: found character that cannot start any token; indent with spaces",
    ),
    ("an open quote", b"a: 1\nb: 'x\n", "is not YAML: found unexpected end of stream; check indentation and quotes"),
    ("bad indentation", b"a: 1\n b: 2\n", "f.yaml:2: is not YAML: mapping values are not allowed"),
    ("latin-1", b"a: 1\nb: \xff\n", "f.yaml:2: is not UTF-8 text; save the file"),
    ("a control character", b"a: \x01\n", "f.yaml: is not YAML: control characters are not allowed"),
    ("two documents", b"a: 1\n---\nb: 2\n", "f.yaml:2: a second document (---) begins here; remove it"),
    ("an anchor", b"a: &x 1\n", "f.yaml:1: anchors (&) and aliases (*) are not used"),
    ("an alias bomb", b"a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\n", "f.yaml:1: anchors (&)"),
    ("an anchored key", b"&a x: 1\n", "f.yaml:1: anchors (&), tags (!) and merge keys"),
    ("a merge key", b"a: 1\n<<: {b: 2}\n", "f.yaml:2: anchors (&), tags (!) and merge keys"),
    ("a tag", b"a: !!python/object:os.system ls\n", "f.yaml:1: tags (!) are not used"),
    ("a key that is a list", b"[a]: 1\n", "f.yaml:1: a key must be a name"),
    ("deep nesting", b"a: " + b"[" * 5000, "f.yaml:1: nested deeper than 24 levels"),
    ("too large", b"#" * (MAX_BYTES + 1), "f.yaml: larger than 16 MiB"),
]


@pytest.mark.parametrize(("content", "message"), [row[1:] for row in UNREADABLE], ids=[row[0] for row in UNREADABLE])
def test_what_cannot_be_read_is_one_problem(content: bytes, message: str) -> None:
    document = read_document(content, "f.yaml")
    assert document.data == {}
    assert len(document.problems) == 1
    assert str(document.problems[0]).startswith(message) or message in str(document.problems[0])
    assert "\n" not in str(document.problems[0])


def test_every_key_written_twice_is_a_problem_and_the_first_counts() -> None:
    document = read_document(b"a: 1\nb: {c: 1, c: 2}\na: {x: 1}\na: 3\n", "f.yaml")
    assert [str(problem) for problem in document.problems] == [
        "f.yaml:2:b.c: `c` is written twice, first in line 2; remove one of them",
        "f.yaml:3:a: `a` is written twice, first in line 1; remove one of them",
        "f.yaml:4:a: `a` is written twice, first in line 1; remove one of them",
    ]
    assert document.data == {"a": 1, "b": {"c": 1}}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("12", 12),
        ("-7", -7),
        ("010", 10),
        ("0x1F", 31),
        ("0o17", 15),
        ("1.5", 1.5),
        (".5", 0.5),
        ("1e3", 1000.0),
        ("true", True),
        ("False", False),
        ("null", None),
        ("~", None),
        # what YAML 1.1 would take for something else
        ("on", "on"),
        ("yes", "yes"),
        ("n", "n"),
        ("1_000", "1_000"),
        ("1:30", "1:30"),
        ("2020-01-01", "2020-01-01"),
        (".inf", ".inf"),
        (".nan", ".nan"),
        ("1" * 50, "1" * 50),
    ],
)
def test_unquoted_scalars_follow_the_core_schema(text: str, value: object) -> None:
    resolved = resolve_scalar(text)
    assert resolved == value or (text == "1" * 50)
    assert type(resolved) is type(value) or text == "1" * 50


def test_variables_are_replaced_and_quotes_keep_them_texts() -> None:
    environment = {"PORT": "4841", "NAME": "x: y # no comment", "EMPTY": ""}
    content = b'a: ${PORT}\nb: "${PORT}"\nc: ${NAME}\nd: a-${PORT}-b\ne: $${PORT}\nf: "${EMPTY}"\ng: $PORT\n'
    document = read_document(content, "f.yaml", environment)
    assert not document.problems
    assert document.data == {
        "a": 4841,
        "b": "4841",
        "c": "x: y # no comment",
        "d": "a-4841-b",
        "e": "${PORT}",
        "f": "",
        "g": "$PORT",
    }


def test_a_variable_that_is_not_set_or_misspelt_is_a_problem_with_its_line() -> None:
    document = read_document(b"a: 1\nb:\n  - ${NO_SUCH}\nc: ${un closed\nd: ${a b}\n", "f.yaml", {})
    assert [str(problem) for problem in document.problems] == [
        "f.yaml:3:b[0]: the environment variable NO_SUCH is not set; run: export NO_SUCH=...",
        "f.yaml:4:c: `${un closed` names no variable; write ${NAME}, or $${ for a plain ${",
        "f.yaml:5:d: `${a b}` names no variable; write ${NAME}, or $${ for a plain ${",
    ]


def test_without_an_environment_variables_stay_as_they_are() -> None:
    assert read_document(b"a: ${X}\n", "f.yaml").data == {"a": "${X}"}


def test_places_are_those_of_keys_and_items() -> None:
    document = read_document(b"\xef\xbb\xbfa:\r\n  b: 1\r\n  c:\r\n  - 1\r\n  - 2\r\n", "f.yaml")
    lines = {path: place.line for path, place in document.places.items()}
    assert lines == {(): 0, ("a",): 1, ("a", "b"): 2, ("a", "c"): 3, ("a", "c", 0): 4, ("a", "c", 1): 5}
    assert document.place_of(("a", "c", 1, "missing")).line == 5


@given(st.binary(max_size=200) | st.text(alphabet="ab:{}[]&*!|>'\"#-?,% \t\r\n$~0", max_size=60).map(str.encode))
def test_no_bytes_make_it_raise(content: bytes) -> None:
    document = read_document(content, "f.yaml", {})
    assert document.problems or isinstance(document.data, dict)
    assert all("\n" not in str(problem) for problem in document.problems)
