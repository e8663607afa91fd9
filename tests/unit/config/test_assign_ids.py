from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ua_fleet.config.assign_ids import assign_ids, insert_ids
from ua_fleet.config.load import load, load_content
from ua_fleet.document import as_mapping, read_document
from ua_fleet.errors import ConfigError, ConfigInvalid

HEAD = (
    "version: 1\npubsub: {security: none}\nbridges:\n  c: {kind: ros1, status_id: 1}\n"
    "robots:\n  ned:\n    bridge: c\n    data:\n"
)

LAYOUTS: list[tuple[str, str, str]] = [
    ("block", "      q:\n        type: Double\n", "      q:\n        id: 1001\n        type: Double\n"),
    ("flow", "      q: {type: Double}\n", "      q: {id: 1001, type: Double}\n"),
    ("spaced flow", "      q: { type: Double }\n", "      q: { id: 1001, type: Double }\n"),
    ("JSON", '      "q": {"type":"Double"}\n', '      "q": {id: 1001, "type":"Double"}\n'),
    (
        "flow over lines",
        "      q: {\n        type: Double,  # x\n        unit: m\n      }\n",
        "      q: {\n        id: 1001, type: Double,  # x\n        unit: m\n      }\n",
    ),
    (
        "comments",
        "      q:  # a\n\n        # b\n        type: Double # c\n",
        "      q:  # a\n        id: 1001\n\n        # b\n        type: Double # c\n",
    ),
    (
        "deep indentation",
        "      q:\n              type: Byte\n",
        "      q:\n              id: 1001\n              type: Byte\n",
    ),
    ("no newline at the end", "      q:\n        type: Double", "      q:\n        id: 1001\n        type: Double"),
    ("no newline, flow", "      q: {type: Double}", "      q: {id: 1001, type: Double}"),
    (
        "quoted names",
        "      'q':\n        'type': \"Double\"\n",
        "      'q':\n        id: 1001\n        'type': \"Double\"\n",
    ),
    (
        "two, and one with an id in between",
        "      q: {type: Double}\n      r: {id: 2000, type: Byte}\n      s:\n        type: Byte\n",
        (
            "      q: {id: 2001, type: Double}\n      r: {id: 2000, type: Byte}\n"
            "      s:\n        id: 2002\n        type: Byte\n"
        ),
    ),
    (
        "umlauts before it",
        "      # äöü €\n      q: {type: Double}\n",
        "      # äöü €\n      q: {id: 1001, type: Double}\n",
    ),
    ("all there", "      q: {id: 7, type: Double}\n", "      q: {id: 7, type: Double}\n"),
]


@pytest.mark.parametrize(("before", "after"), [row[1:] for row in LAYOUTS], ids=[row[0] for row in LAYOUTS])
@pytest.mark.parametrize("line_break", ["\n", "\r\n"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_layouts(before: str, after: str, line_break: str, mark: str) -> None:
    content, expected = ((mark + (HEAD + text).replace("\n", line_break)).encode() for text in (before, after))
    changed, _ = insert_ids(content, "f.yaml")
    assert changed == expected
    assert insert_ids(changed, "f.yaml") == (changed, {})


def test_bridges_get_a_status_id_in_the_order_of_the_file() -> None:
    content = b"version: 1\nrobots:\n  r: {bridge: b, data: {q: {type: Byte}}}\nbridges:\n  b:\n    kind: ros1\n"
    changed, given_ids = insert_ids(content, "f.yaml")
    assert given_ids == {"robots.r.data.q.id": 1001, "bridges.b.status_id": 1002}
    assert b"  b:\n    status_id: 1002\n    kind: ros1\n" in changed


def test_a_layout_without_a_place_for_an_id_is_refused() -> None:
    with pytest.raises(ConfigInvalid, match=r"f\.yaml:9:robots\.ned\.data\.q.*no place for an id.*by hand"):
        insert_ids((HEAD + "      ? q\n      : type: Double\n        unit: m\n").encode(), "f.yaml")


def test_no_id_is_used_again_when_all_are_used_up() -> None:
    content = (HEAD + "      q: {id: 65535, type: Byte}\n      r: {type: Byte}\n").encode()
    with pytest.raises(ConfigInvalid, match=r"no id is left for robots\.\w+\.data\.r\.id"):
        insert_ids(content, "f.yaml")


def test_the_file_keeps_its_mode_and_links_stay_links(tmp_path: Path) -> None:
    real = tmp_path / "real.yaml"
    real.write_text(HEAD + "      q: {type: Double}\n")
    real.chmod(0o640)
    link = tmp_path / "fleet.yaml"
    link.symlink_to(real)
    assert assign_ids(link, {}) == {"robots.ned.data.q.id": 1001}
    assert link.is_symlink()
    assert real.stat().st_mode & 0o777 == 0o640
    assert load(link, {}).robots["ned"].data["q"].id == 1001
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fleet.yaml", "real.yaml"]
    before = real.stat().st_mtime_ns
    assert assign_ids(link, {}) == {}
    assert real.stat().st_mtime_ns == before


def test_a_file_with_other_problems_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "fleet.yaml"
    path.write_text(HEAD + "      q: {type: Doble}\n")
    content = path.read_bytes()
    with pytest.raises(ConfigInvalid, match="did you mean `Double`"):
        assign_ids(path, {})
    assert path.read_bytes() == content


def test_the_environment_gives_no_ids(tmp_path: Path) -> None:
    path = tmp_path / "fleet.yaml"
    path.write_text(HEAD + "      q: {type: Double}\n")
    assert assign_ids(path, {"UA_FLEET__ROBOTS__NED__DATA__Q__ID": "9"}) == {"robots.ned.data.q.id": 1001}


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    path = tmp_path / "fleet.yaml"
    path.write_text(HEAD + "      q: {type: Double}\n")
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(ConfigError, match="cannot be written: permission denied"):
            assign_ids(path, {})
    finally:
        tmp_path.chmod(0o700)


# --- any layout: the bytes outside of the insertions stay, and nothing but the ids is said anew

COMMENTS = st.sampled_from(["", "  # a comment", "  # id: 5 {", "  # ä 'x' \"", "\t# tab"])
SPACES = st.sampled_from(["", " ", "  "])


@st.composite
def data_sources(draw: st.DrawFn, indent: str) -> str:
    """One data source below `indent`, in some style."""
    name = draw(st.sampled_from(["a", "b", "c", "d", "e"]))
    shown = draw(st.sampled_from([name, f"'{name}'", f'"{name}"']))
    keys = {"type": draw(st.sampled_from(["Double", '"Byte"', "'Int32'"]))}
    if draw(st.booleans()):
        keys["description"] = draw(st.sampled_from(["plain text", "'id: 3'", '"{x}: [y]"', '"\\"quoted\\""']))
    if draw(st.booleans()):
        keys["id"] = str(draw(st.integers(1, 1100)))
    order = draw(st.permutations(list(keys)))
    if draw(st.booleans()):
        space = draw(SPACES)
        separator = draw(st.sampled_from([", ", ",", f",\n{indent}    ", f", # c\n{indent}     "]))
        body = separator.join(f"{key}: {keys[key]}" for key in order)
        return f"{indent}{shown}: {{{space}{body}{space}}}{draw(COMMENTS)}\n"
    inner = indent + draw(st.sampled_from([" ", "  ", "      "]))
    lines = [f"{indent}{shown}:{draw(COMMENTS)}"]
    for key in order:
        lines += draw(st.sampled_from([[], [""], [f"{inner}# {key}"], ["# at the margin"], ["   "]]))
        lines.append(f"{inner}{key}:{draw(st.sampled_from([' ', '   ']))}{keys[key]}{draw(COMMENTS)}")
    return "\n".join(lines) + "\n"


@st.composite
def fleets(draw: st.DrawFn) -> str:
    """A file with robots that have a few data sources each."""
    text = draw(st.sampled_from(["", "# first\n", "%YAML 1.1\n---\n", "---\n"])) + "version: 1\n"
    pubsub = "pubsub: {security: none}\n"
    bridges = "bridges:\n  c: {kind: ros1" + draw(st.sampled_from([", status_id: 900", ""])) + "}\n"
    robots = "robots:\n"
    for robot in draw(st.lists(st.sampled_from(["r", "s", "t"]), unique=True, max_size=3)):
        robots += f"  {robot}:\n    bridge: c\n    data:{draw(COMMENTS)}\n"
        sources = draw(st.lists(data_sources(indent="      "), max_size=4))
        names = [re.sub(r"['\" ]", "", source.split(":")[0]) for source in sources]
        robots += "".join(source for i, source in enumerate(sources) if names[i] not in names[:i])
    for section in draw(st.permutations([pubsub, bridges, robots])):
        text += section
    if draw(st.booleans()):
        text = text.rstrip("\n")
    return draw(st.sampled_from(["", "\ufeff"])) + text.replace("\n", draw(st.sampled_from(["\n", "\r\n"])))


def without(content: bytes, given_ids: dict[str, int]) -> bytes:
    """The content with what was inserted for these ids cut out again."""
    for path, number in given_ids.items():
        key = path.rpartition(".")[2]
        piece = rf"(?:(?<=[\r\n])[ ]*{key}: {number}(?:\r\n|\n)|(?<=[{{ ]){key}: {number}, )"
        content, count = re.subn(piece.encode(), b"", content)
        assert count == 1
    return content


def stripped_ids(data: Any) -> Any:
    inner = as_mapping(data)
    if inner is None:
        return data
    return {key: stripped_ids(value) for key, value in inner.items() if key not in ("id", "status_id")}


def ids_in(data: Any) -> list[int]:
    inner = as_mapping(data) or {}
    own = [inner[key] for key in ("id", "status_id") if key in inner]
    return own + [number for value in inner.values() for number in ids_in(value)]


@settings(max_examples=300)
@given(fleets())
def test_every_other_byte_stays_and_the_file_says_the_same(text: str) -> None:
    content = text.encode()
    changed, given_ids = insert_ids(content, "f.yaml")
    assert without(changed, given_ids) == content
    before, after = read_document(content, "f.yaml"), read_document(changed, "f.yaml")
    assert stripped_ids(after.data) == stripped_ids(before.data)
    assert insert_ids(changed, "f.yaml") == (changed, {})
    in_file = ids_in(before.data)
    assert not set(given_ids.values()) & set(in_file)
    assert all(number >= 1001 for number in given_ids.values())
    if len(set(in_file)) == len(in_file):
        old = load_content(content, "f.yaml", {}, allow_missing_ids=True)
        new = load_content(changed, "f.yaml", {})
        for robot in new.robots:
            assert new.robots[robot].bridge == old.robots[robot].bridge
            for name, dataset in new.robots[robot].data.items():
                assert dataset.model_copy(update={"id": None}) == old.robots[robot].data[name].model_copy(
                    update={"id": None}
                )
