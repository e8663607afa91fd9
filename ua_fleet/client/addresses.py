"""How people name a node: a NodeId, a UA topic, or a path of browse names below Objects."""

from __future__ import annotations

import re
from typing import Final

from ua_fleet.errors import TopicInvalid
from ua_fleet.topics import Topic

__all__ = ["NodeAddress", "parse_address"]

NodeAddress = str | tuple[str, ...]
"""A NodeId in its string form, or browse names from Objects downwards (`2:ned` names the namespace too)."""

_NODE_ID: Final = re.compile(r"(ns=\d+;)?[isgb]=.+", re.DOTALL)


def parse_address(text: str) -> NodeAddress:
    """The address that a text stands for.

    `ns=2;i=1001` and `i=85` are NodeIds, `ua_1_2_1001` is the node of that topic, and anything else is a path such as
    `Fleet/Robots/ned/battery`.
    """
    if _NODE_ID.fullmatch(text):
        return text
    try:
        topic = Topic.parse(text)
    except TopicInvalid:
        return tuple(part for part in text.split("/") if part and part != "Objects")
    return f"ns={topic.ns};i={topic.id}"
