"""The DataSet by which a bridge tells whoever watches of the runs that it carries: where the token is, steps, rankings.

Each bridge that carries has it, at the DataSetWriterId below the one of `CarryRun`. It has no form in another space,
and is no node: the server shows the whole run, of all its bridges.
"""

from __future__ import annotations

from typing import Final

from ua_fleet.pubsub.carry_action import CARRY_ID
from ua_fleet.pubsub.metadata import NODE_ONLY, make_field, type_codes
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType

__all__ = [
    "RUN_DATA_COUNT",
    "RUN_DATA_FIELDS",
    "RUN_DATA_HOLDS",
    "RUN_DATA_ID",
    "RUN_DATA_RANKING",
    "RUN_DATA_TYPES",
    "run_data_topic",
]

RUN_DATA_ID: Final = CARRY_ID - 1
"""Its DataSetWriterId, which no other DataSet should have."""
_STRING, _UINT16 = BuiltinType.STRING, BuiltinType.UINT16
RUN_DATA_FIELDS: Final = (
    make_field("Run", _STRING, properties={NODE_ONLY: True}),
    make_field("Holds", _UINT16, array=True),
    make_field("HandsTo", _UINT16, array=True),
    make_field("Tasks", _STRING, array=True),
    make_field("Robots", _STRING, array=True),
    make_field("States", _STRING, array=True),
    make_field("Message", _STRING),
    make_field("Candidates", _STRING, array=True),
    make_field("Scores", BuiltinType.FLOAT, array=True),
    make_field("Facts", BuiltinType.UINT32),
    make_field("Outcome", _STRING),
)
"""The run of which something is new; the segments that the bridge has the tokens of; the spaces to which it hands one
over and that have not acknowledged it; the tasks that have begun or ended since the message before, with their robots
and states; a line for people of the last of them; the last ranking of substitutes, the best first; the number of facts
that the server can fetch; how the run has ended here, empty before."""
RUN_DATA_TYPES: Final = type_codes(RUN_DATA_FIELDS)
RUN_DATA_HOLDS: Final = 1
"""Where the segments stand of which it has the tokens."""
RUN_DATA_RANKING: Final = slice(7, 9)
"""Where the last ranking stands: robots, and their scores."""
RUN_DATA_COUNT: Final = 9
"""Where the number of facts stands."""


def run_data_topic(space: int, ns: int) -> Topic:
    """The DataSet of a bridge; `ns` is the fleet's namespace."""
    return Topic(space, ns, RUN_DATA_ID)
