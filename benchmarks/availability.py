"""Requests of strings on an open-loop schedule, and their response time: the tests of Tamashiro et al., section 3.

A requestor asks a robot to print a string of 10 to 20,000 characters every 1 to 100 ms, whatever became of the strings
before; and to give it back, one string after the other. Alone, and beside five nodes that each send 1,000 characters
again and again with pauses of 1 to 20 ms. All are processes of their own, PubSub is signed and encrypted, and every
request is journaled on the disk at both sides.

A request that could not even be made within 0.1 s after its slot counts as requested, and as refused. At the end what
the robot was told is compared with what each requestor knows: executed + refused = requested, for every one, and
nothing twice; where that does not hold, the group fails. The floor is an echo between two event loops on the same
schedule; the peer for the response time alone is a service of ROS 2 (rclpy), which records and encrypts nothing.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Generator, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from benchmarks._availability import LEAST_PAUSE_S, SPACE, Asked
from benchmarks._keys import write_keys
from benchmarks._ros import NODES, Node, median_and_p99, running_node
from benchmarks.harness import FEWEST_ROUNDS, Failed, Figure, shown
from tests import system
from ua_fleet.config.schema import FleetConfig

REFERENCE = "bare UDP echo"
PEER = "service of ROS 2"
CHARACTERS = (10, 1000, 10_000, 20_000)
REQUESTS = {1: 1000, 5: 200, 10: 100, 20: 100, 50: 20, 100: 10}
"""Requests of each length, over all rounds, by the period in milliseconds."""
HELD_FROM_MS = 20
"""Periods from here on have to reach an availability of 1."""
RESPONSES = 20
"""In a round, of each length."""
OVERHEAD_BYTES = 180
"""About what a signed and encrypted request has beside its string."""
NODE_SPACES = (301, 302, 303, 304, 305)


def accounted(told: Sequence[str], parties: Iterable[Asked]) -> None:
    """Compare what the robot was told with what each requestor knows, id by id.

    Args:
        told: ids of the executions that the robot was told.
        parties: what was requested, and what the requestor knows of it.

    Raises:
        Failed: they disagree about a single request.
    """
    times, known = Counter(told), set[str]()
    if doubled := [one for one, count in times.items() if count > 1]:
        raise Failed(f"the robot was told {len(doubled)} executions twice")
    for asked in parties:
        executed = times.keys() & set(asked.ids)
        known |= executed
        unknown, untold = executed - set(asked.accepted), set(asked.accepted) - executed
        if unknown or untold:
            raise Failed(
                f"a requestor does not know that {len(unknown)} were executed, and takes {len(untold)} for executed"
                f" that were not: {dict(asked.outcomes)}"
            )
        if len(executed) + asked.refused != asked.slots:
            raise Failed(f"{len(executed)} executed + {asked.refused} refused of {asked.slots}: {dict(asked.outcomes)}")
    if unasked := times.keys() - known:
        raise Failed(f"the robot was told {len(unasked)} executions that nobody asked for")


class Network:
    """The robot, who asks it, an echo, and a service of ROS 2 where there is ROS 2."""

    def __init__(self, stack: contextlib.ExitStack) -> None:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(dir=system.ROOT)))
        raw = {
            "version": 1,
            "pubsub": {
                "security": "sign_and_encrypt",
                "url": system.free_multicast_url(),
                "keys": {"source": "files"},
            },
            "bridges": {
                "cell": {"kind": "virtual", "space": SPACE, "requestors": [0, *NODE_SPACES]},
                **{f"node-{space}": {"kind": "virtual", "space": space} for space in NODE_SPACES},
            },
        }
        fleet = folder / "fleet.json"
        fleet.write_text(json.dumps(raw))
        write_keys(folder, FleetConfig.model_validate(raw))

        def start(module: str, *arguments: object) -> Node:
            command = [sys.executable, "-m", f"benchmarks.{module}", *map(str, arguments)]
            node = Node(*command, env=os.environ | {"PYTHONPATH": ".:bridges"})
            stack.callback(node.end)
            return node

        self._robot = start("_availability", "passive", fleet)
        self._main = start("_availability", "main", fleet)
        self._nodes = [start("_availability", "node", fleet, space) for space in NODE_SPACES]
        self._port = int(start("_actions", "echo", 0).ready.removeprefix("ready"))
        self._told()
        self._asked: list[Asked] = []
        self._peer = None if system.missing("ros2") else _ros2_service(stack)

    def _told(self) -> list[str]:
        self._robot.tell("executed")
        told: list[str] = json.loads(self._robot.read())
        return told

    def ask(self, way: str, characters: int, *numbers: int) -> Asked:
        """Have the main node ask our robot (`open`, `respond`) or the echo (`echo-open`, `echo-respond`)."""
        is_echo = way.startswith("echo")
        size, port = (characters + OVERHEAD_BYTES, (self._port,)) if is_echo else (characters, ())
        self._main.tell(" ".join(map(str, (way, size, *numbers, *port))))
        asked = Asked.read(self._main.read())
        if not is_echo:
            self._asked.append(asked)
        return asked

    def ask_peer(self, characters: int) -> list[float]:
        """Round trips (microseconds) of the service of ROS 2; none without it."""
        if self._peer is None:
            return []
        self._peer.tell(f"{characters} {RESPONSES} {LEAST_PAUSE_S}")
        return self._peer.ages()

    @contextlib.contextmanager
    def held_to_account(self, *, others: bool) -> Generator[None]:
        """While the context lasts, with the five nodes or without; then everything is accounted for."""
        nodes = self._nodes if others else []
        for node in nodes:
            node.tell("go")
        yield
        for node in nodes:
            node.tell("rest")
        parties = [*self._asked, *[Asked.read(node.read()) for node in nodes]]
        accounted(self._told(), parties)  # only now has everybody heard of the last request
        self._asked.clear()


def _ros2_service(stack: contextlib.ExitStack) -> Node:
    """Who calls a service that gives strings back, in a domain of their own."""
    domain = stack.enter_context(system.ros_domain())
    env = os.environ | {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    stack.enter_context(running_node(sys.executable, NODES / "echo_ros2.py", "serve", env=env))
    return stack.enter_context(running_node(sys.executable, NODES / "echo_ros2.py", "call", env=env))


class Run(NamedTuple):
    """What was measured in one of the two distributions of nodes."""

    shares: dict[int, list[float]]
    """Availability by the period in milliseconds, for each length."""
    floor_shares: dict[int, float]
    """Of the echo, the worst length."""
    responses: list[tuple[float, float, float, float]]
    """For each length: the echo's median and 99th percentile, and ours."""
    peers: list[float]
    """For each length: the median of the service of ROS 2; empty where it was not asked."""


def measured(network: Network, rounds: int, *, with_peer: bool) -> Run:
    """Everything once in each round; the floor's schedules in the last one alone."""
    slots, executed = Counter[tuple[int, int]](), Counter[tuple[int, int]]()
    floor: dict[int, float] = {}
    echoed: list[list[float]] = [[] for _ in CHARACTERS]
    responded: list[list[float]] = [[] for _ in CHARACTERS]
    served: list[list[float]] = [[] for _ in CHARACTERS]
    for turn in range(rounds):
        for place, characters in enumerate(CHARACTERS):
            echoed[place] += network.ask("echo-respond", characters, RESPONSES).ages_us
            responded[place] += network.ask("respond", characters, RESPONSES).ages_us
            if with_peer:
                served[place] += network.ask_peer(characters)
            for period_ms, count in REQUESTS.items():
                asked = network.ask("open", characters, period_ms, count // rounds)
                slots[period_ms, characters] += asked.slots
                executed[period_ms, characters] += len(asked.accepted)
                if turn == rounds - 1:
                    asked = network.ask("echo-open", characters, period_ms, count // rounds)
                    share = asked.outcomes["accepted"] / asked.slots
                    floor[period_ms] = min(floor.get(period_ms, 1.0), share)
    shares = {ms: [executed[ms, length] / slots[ms, length] for length in CHARACTERS] for ms in REQUESTS}
    responses = [(*median_and_p99(echo), *median_and_p99(ours)) for echo, ours in zip(echoed, responded, strict=True)]
    return Run(shares, floor, responses, [median_and_p99(of_length)[0] for of_length in served if of_length])


def rows(name: str, run: Run) -> list[Figure]:
    """The figures of one distribution of nodes."""
    figures: list[Figure] = []
    for characters, (echo_p50, echo_p99, p50, p99) in zip(CHARACTERS, run.responses, strict=True):
        what = f"response time, {name}, {characters:,} characters"
        figures.append(shown(f"{what}, p50", p50, "us", reference=REFERENCE, reference_value=echo_p50))
        figures.append(shown(f"{what}, p99", p99, "us", reference=REFERENCE, reference_value=echo_p99))
    for characters, peer, (_, _, p50, _) in zip(CHARACTERS, run.peers, run.responses, strict=False):
        name_of_row = f"response time, {name}, {characters:,} characters, p50, beside a service"
        figures.append(shown(name_of_row, p50, "us", reference=PEER, reference_value=peer))
    for period_ms, shares in run.shares.items():
        for what, share in (("up to 10,000 characters", min(shares[:-1])), ("20,000 characters", shares[-1])):
            is_held = period_ms >= HELD_FROM_MS
            figures.append(
                Figure(
                    f"availability every {period_ms} ms, {name}, {what}",
                    share,
                    "of 1",
                    REFERENCE,
                    run.floor_shares[period_ms],
                    share,
                    1.0 if is_held else None,
                    not is_held or share == 1.0,
                )
            )
    return figures


def figures(rounds: int) -> list[Figure]:
    rounds = max(rounds, FEWEST_ROUNDS)
    found: list[Figure] = []
    with contextlib.ExitStack() as stack:
        network = Network(stack)
        for name, others in (("alone", False), ("with five nodes", True)):
            with network.held_to_account(others=others):
                run = measured(network, rounds, with_peer=not others)
            found += rows(name, run)
    return found
