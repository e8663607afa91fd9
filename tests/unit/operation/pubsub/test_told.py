"""The Diagnostics of a bridge are those that its status tells, and not Good while it is away."""

from __future__ import annotations

from collections.abc import Iterable

from ua_fleet.counters import Counters
from ua_fleet.operation.pubsub.connections import Resets
from ua_fleet.operation.pubsub.told import ToldDiagnostics
from ua_fleet.pubsub import make_field
from ua_fleet.pubsub.components import CONNECTION, writer, writer_group
from ua_fleet.pubsub.group_figures import FIGURES_FIELD, GroupFigures, packed
from ua_fleet.pubsub.remote_writer import RemoteWriter
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, StatusCode
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMessage, DataSetMetaData

FIELDS = (make_field("Name", BuiltinType.STRING), make_field(FIGURES_FIELD, BuiltinType.UINT32, array=True))
GROUP = writer_group(2)


class Told:
    """A bridge that tells of itself."""

    def __init__(self) -> None:
        self.status = RemoteWriter(Topic(3, 2, 900), 0.0, Counters())
        self.is_heard = True
        self.diagnostics = ToldDiagnostics(
            "PubSub.bridges.b", lambda: self.status, lambda: self.is_heard, "239.0.0.{}".format, Resets()
        )

    def say(self, figures: Iterable[GroupFigures]) -> None:
        self.status.metadata = DataSetMetaData("status", FIELDS, ConfigurationVersion(1, 1))
        self.status.last_frame = DataSetMessage(900, values=("b", packed(figures)))

    def value(self, way: str) -> tuple[object, int]:
        made = self.diagnostics(GROUP)
        assert made is not None
        value, status = made.values()[f"Diagnostics.{way}"].now()
        return value, status


def test_nothing_is_shown_of_what_a_bridge_does_not_tell_of() -> None:
    told = Told()
    assert told.diagnostics(CONNECTION) is None
    told.say([GroupFigures(0), GroupFigures(2, 7)])
    assert told.diagnostics(CONNECTION) is not None
    assert told.diagnostics(writer(2, 1001)) is None
    assert told.diagnostics(writer_group(4)) is None
    assert not told.diagnostics.reset(writer_group(4))


def test_the_counters_follow_the_status_and_begin_anew_after_reset() -> None:
    told = Told()
    told.say([GroupFigures(0), GroupFigures(2, 7, failed=2, configured=5, operational=4)])
    assert told.value("Counters.SentNetworkMessages") == (7, 0)
    assert told.value("TotalError") == (2, 0)
    assert told.value("LiveValues.OperationalDataSetWriters") == (4, 0)
    whole = told.diagnostics(CONNECTION)
    assert whole is not None
    assert whole.sub_error()
    assert told.diagnostics.reset(GROUP)
    assert not whole.sub_error()
    told.say([GroupFigures(0), GroupFigures(2, 9, failed=2)])
    assert told.value("Counters.SentNetworkMessages") == (2, 0)
    assert told.value("TotalError") == (0, 0)


def test_what_is_not_of_now_is_not_good() -> None:
    told = Told()
    told.say([GroupFigures(0), GroupFigures(2, 7)])
    told.is_heard = False
    assert told.value("Counters.SentNetworkMessages") == (7, StatusCode.BAD_NO_COMMUNICATION)
