"""Nodes as a tree."""

from __future__ import annotations

from ua_fleet.cli.tree import left_out_text, tree_lines
from ua_fleet.client import NodeInfo


def node(name: str, depth: int, *, type_name: str | None = None, left_out: int | None = 0) -> NodeInfo:
    kind = "Object" if type_name is None else "Variable"
    return NodeInfo(f"ns=2;s={name}", name, name, kind, depth, type_name, left_out=left_out)


def test_lines_join_what_belongs_together() -> None:
    nodes = [
        node("rover", 0),
        node("pose", 1),
        node("x", 2, type_name="Double"),
        node("y", 2, type_name="Double[]"),
        node("State", 1, type_name="Int32"),
        node("drone", 0),
        node("Skills", 1, left_out=1200),
    ]
    assert tree_lines(nodes, {"ns=2;s=x": "1.5 m"}) == [
        "├─ rover  [Object]  ns=2;s=rover",
        "│  ├─ pose  [Object]  ns=2;s=pose",
        "│  │  ├─ x  [Double]  ns=2;s=x  = 1.5 m",
        "│  │  └─ y  [Double[]]  ns=2;s=y",
        "│  └─ State  [Int32]  ns=2;s=State",
        "└─ drone  [Object]  ns=2;s=drone",
        "   └─ Skills  [Object]  ns=2;s=Skills  … 1,200 below",
    ]


def test_one_level_is_a_list() -> None:
    named = NodeInfo("ns=2;s=Fleet", "Fleet", "Hall\x1b[2J", "Object", 0)
    assert tree_lines([named, node("x", 0, type_name="Double")], {}) == [
        "Fleet (Hall\\x1b[2J)  [Object]  ns=2;s=Fleet",
        "x  [Double]  ns=2;s=x",
    ]
    assert tree_lines([], {}) == []


def test_what_is_not_listed_is_told() -> None:
    assert left_out_text([node("a", 0)], 1) == ""
    assert left_out_text([node("a", 0, left_out=1)], 1) == "1 node is directly below these; --depth 2 lists them"
    both = [node("a", 0, left_out=1000), node("b", 0, left_out=1)]
    assert left_out_text(both, 3) == "1,001 nodes are directly below these; --depth 4 lists them"
    assert left_out_text([node("a", 0, left_out=None)], 1).startswith("levels below 1 were not looked at")
