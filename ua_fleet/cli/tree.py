"""A tree of nodes as lines. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from ua_fleet.cli.table import Colour, painted

if TYPE_CHECKING:
    from ua_fleet.client import NodeInfo

__all__ = ["left_out_text", "tree_lines"]


def tree_lines(nodes: Sequence[NodeInfo], values: Mapping[str, str], *, colours: bool = False) -> list[str]:
    """A line for each node: its name, its class or type, its NodeId, its value where there is one, and what is cut.

    Args:
        nodes: depth first, as they were browsed.
        values: what is to be said of the value of a node, by its place in `nodes`' NodeIds.
        colours: whether there are colours.
    """
    is_flat = all(node.depth == 0 for node in nodes)
    lasts = _lasts(nodes)
    lines: list[str] = []
    open_levels: list[bool] = []
    for node, is_last in zip(nodes, lasts, strict=True):
        del open_levels[node.depth :]
        stem = "".join("│  " if goes_on else "   " for goes_on in open_levels) + ("└─ " if is_last else "├─ ")
        open_levels.append(not is_last)
        name = painted(node.browse_name, Colour.HEAD, colours=colours)
        if node.display_name != node.browse_name:
            name += painted(f" ({node.display_name})", None, colours=colours)
        kind = node.type_name or node.node_class
        parts = ["" if is_flat else stem, name, "  ", painted(f"[{kind}]", None, colours=colours)]
        parts.append(painted(f"  {node.node_id}", Colour.FAINT, colours=colours))
        if node.node_id in values:
            parts.append(f"  = {painted(values[node.node_id], None, colours=colours)}")
        if node.left_out:
            parts.append(painted(f"  … {node.left_out:,} below", Colour.FAINT, colours=colours))
        lines.append("".join(parts))
    return lines


def _lasts(nodes: Sequence[NodeInfo]) -> list[bool]:
    """Whether each node is the last one below its parent."""
    lasts: list[bool] = []
    after: set[int] = set()  # levels at which another node follows, as seen from the end
    for node in reversed(nodes):
        lasts.append(node.depth not in after)
        after = {level for level in after if level < node.depth} | {node.depth}
    return lasts[::-1]


def left_out_text(nodes: Sequence[NodeInfo], depth: int) -> str:
    """What is to be said of the levels that are not listed; empty where there are none."""
    if any(node.left_out is None for node in nodes):
        return f"levels below {depth} were not looked at; --depth {depth + 1} lists another one"
    left_out = sum(node.left_out or 0 for node in nodes)
    if not left_out:
        return ""
    are = "node is" if left_out == 1 else "nodes are"
    return f"{left_out:,} {are} directly below these; --depth {depth + 1} lists them"
