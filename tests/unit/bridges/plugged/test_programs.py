"""Programs on the D-Bus that misbehave, beside one that does not."""

from __future__ import annotations

from typing import Any

from ua_bridges.plugged.bus import Signal
from ua_bridges.plugged.config import PluggedSource
from ua_bridges.plugged.programs import MOST_BAD, MOST_LEAVES, Programs
from ua_bridges.plugged.sensor import Sensor

from ua_fleet.bridge import DriverEvent, Offenders, SampleRead, SourceFound, SourceLost
from ua_fleet.bridge.configured import configured_sources
from ua_fleet.bridge.executing import Executing
from ua_fleet.config.load import load_content
from ua_fleet.topics import Topic

FLEET = """
version: 1
pubsub: {security: none}
bridges: {pc: {kind: plugged, space: 300, status_id: 1}}
robots:
  rover_pc:
    bridge: pc
    data:
      gas: {id: 10, type: Double, source: {signal: org.gas, when: always}}
      tap: {id: 11, type: String, source: {signal: org.tap, when: always}}
"""
GAS, TAP = Topic(300, 2, 10), Topic(300, 2, 11)


class Bench:
    def __init__(self) -> None:
        self.events: list[DriverEvent] = []
        self.now = 100.0
        self.offenders = Offenders(self)
        config = load_content(FLEET.encode(), "f.yaml", {})
        self.sensors = {
            data.topic: Sensor(data, self.put, Executing(self.put))
            for data in configured_sources(config, "pc", PluggedSource)
        }
        self.signals = {
            Signal(name, name, "Value"): [self.sensors[topic]] for name, topic in (("org.gas", GAS), ("org.tap", TAP))
        }
        self.programs = Programs(self.signals, self.offenders)
        for name in ("org.gas", "org.tap"):
            self.own(name, True)

    def put(self, event: DriverEvent) -> None:
        self.events.append(event)

    def own(self, name: str, is_owned: bool) -> None:
        self.programs.owned(name, is_owned, self.now, 1)

    def say(self, name: str, *body: Any) -> None:
        self.programs.heard(Signal(name, name, "Value"), body, self.now, 1)

    def kinds(self, topic: Topic) -> list[str]:
        names = {SourceFound: "found", SourceLost: "lost"}
        told = [event for event in self.events if isinstance(event, SourceFound | SourceLost) and event.topic == topic]
        return [names[type(event)] for event in told]

    def values(self, topic: Topic) -> list[Any]:
        return [
            event.values[0]
            for event in self.events
            if isinstance(event, SampleRead) and event.topic == topic and not event.status
        ]


def test_signals_that_are_not_what_the_data_has_put_their_program_aside_alone() -> None:
    bench = Bench()
    for _ in range(3):
        for _ in range(MOST_BAD - 1):
            bench.say("org.tap", 1, 2)
        bench.say("org.tap", "open")
    assert bench.offenders.told(bench.now) == {}
    for _ in range(MOST_BAD):
        bench.say("org.tap", 1, 2)
    reason = f"{MOST_BAD} signals in a row have not as many arguments as the data has fields"
    assert bench.offenders.told(bench.now) == {"org.tap": reason}
    bench.say("org.tap", "shut")
    bench.say("org.gas", 1.5)
    assert bench.values(GAS) == [1.5]
    assert bench.values(TAP) == ["open"] * 3
    assert (bench.kinds(GAS), bench.kinds(TAP)) == (["found"], ["found", "lost"])
    times = bench.programs.turn(bench.now, 1)
    bench.now = min(at for at in times if at is not None)
    bench.programs.turn(bench.now, 1)
    bench.say("org.tap", "shut")
    assert bench.values(TAP)[-1] == "shut"
    assert bench.kinds(TAP) == ["found", "lost", "found"]


def test_a_program_that_comes_and_goes_is_put_aside_and_looked_at_again() -> None:
    bench = Bench()
    for _ in range(500):
        bench.now += 0.001
        bench.own("org.tap", False)
        bench.own("org.tap", True)
    assert bench.kinds(TAP) == ["found", "lost"] * (MOST_LEAVES + 1)
    assert "left the D-Bus 8 times" in bench.offenders.told(bench.now)["org.tap"]
    bench.programs.turn(bench.now + 2.0, 1)
    assert bench.kinds(TAP)[-1] == "found"
    assert bench.kinds(GAS) == ["found"]


def test_one_that_is_restarted_now_and_then_is_not() -> None:
    bench = Bench()
    for _ in range(50):
        bench.now += 2.0
        bench.own("org.tap", False)
        bench.own("org.tap", True)
    assert bench.offenders.told(bench.now) == {}
    assert bench.kinds(TAP).count("found") == 51


def test_a_mistake_of_ours_with_one_costs_that_one() -> None:
    bench = Bench()
    bench.sensors[TAP].turn = None  # type: ignore[method-assign,assignment]  # as a mistake would
    bench.programs.turn(bench.now, 1)
    assert "a mistake of the bridge" in bench.offenders.told(bench.now)["org.tap"]
    bench.say("org.gas", 2.0)
    assert bench.values(GAS) == [2.0]
