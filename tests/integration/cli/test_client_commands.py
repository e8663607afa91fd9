"""browse, read, write and watch against a server that `ua-fleet serve` runs."""

from __future__ import annotations

import asyncio
import json
import signal
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from tests.integration.cli.conftest import Site, command
from tests.integration.peer import Peer
from tests.system import forked
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType

# As assign-ids gives them, in the order of the file: the bridge's status first.
SPEED, GOAL, NAME, STEPS, POSE = (
    f"ua_{space}_2_{number}" for space, number in zip((2, 0, 0, 0, 2), range(1002, 1007), strict=True)
)


def test_browse(site: Site) -> None:
    ended = site.run("browse", "Hall/Robots", "--depth", "4", "--json", user="olga")
    assert ended.code == 0
    nodes = {node["browse_name"]: node for node in ended.objects}
    assert nodes["speed"]["node_id"] == "ns=2;i=1002"
    assert nodes["rover"]["depth"] < nodes["speed"]["depth"]
    assert nodes["speed"]["type_name"] == "Double"
    assert nodes["steps"]["type_name"] == "Int32[]"
    assert nodes["State"]["type_name"] == "RobotStateEnumeration"
    text = site.run("browse", user="olga").stdout
    assert "Fleet (Hall)  [Object]  ns=2;s=Fleet  … " in text


def test_browse_is_a_tree_and_says_what_it_leaves_out(site: Site) -> None:
    site.run("write", GOAL, "0.5")
    ended = site.run("browse", "rover", "--depth", "2", "--values", user="olga")
    assert ended.code == 0, ended.stderr
    lines = ended.stdout.splitlines()
    assert '├─ Capacities  [String[]]  ns=2;s=Robots.rover.Capacities  = ["mobile"]' in lines
    assert any(line.startswith("   ├─ goal  [Double]  ns=2;i=1003  = 0.5") for line in lines)
    assert any(line.startswith("   ├─ name  [String]  ns=2;i=1004  = ") for line in lines)
    assert any(line.startswith("   └─ pose  [Object]  ns=2;i=1006  … 2 below") for line in lines)
    # The two fields of the pose, and what says how the history is kept of four Variables.
    assert "6 nodes are directly below these; --depth 3 lists them" in ended.stderr
    whole = site.run("browse", "rover", "--depth", "5", "--json", user="olga")
    assert whole.stderr == ""
    names = [one["browse_name"] for one in whole.objects]
    assert names.index("pose") < names.index("x")


def test_each_way_to_name_a_node_reads_the_same(site: Site) -> None:
    path = "Fleet/Robots/rover/goal"
    whole = "Objects/Hall/Robots/G00/2:rover/Data/goal"
    ended = site.run("read", GOAL, "ns=2;i=1003", path, whole, "--json", user="olga")
    assert ended.code == 0, ended.stderr
    assert [reading["node"] for reading in ended.objects] == [GOAL, "ns=2;i=1003", path, whole]
    assert {reading["node_id"] for reading in ended.objects} == {"ns=2;i=1003"}
    assert {reading["type"] for reading in ended.objects} == {"Double"}


def test_a_value_that_never_came_is_not_shown_as_one(site: Site) -> None:
    ended = site.run("read", NAME)
    assert (ended.code, ended.stdout.split()[:4]) == (0, [NAME, "=", "-", "BadWaitingForInitialData"])


def test_robots_are_read_by_their_names(site: Site) -> None:
    site.run("write", GOAL, "0.25")
    whole = site.run("read", "rover", "--json", user="olga").objects
    held = ("Held", "HeldBy", "HeldSince", "HeldReason")
    values = ("speed", "goal", "name", "steps", "pose/x", "pose/frame")
    assert [one["node"] for one in whole] == [f"rover/{name}" for name in ("State", "LastUpdate", *held, *values)]
    text = site.run("read", "rover.goal", "rover", "--utc", user="olga")
    assert (text.code, text.stdout.count("goal = 0.25  20")) == (0, 1)  # it is not told again below rover
    assert "+00:00" in text.stdout
    assert "have never come (BadWaitingForInitialData); --empty shows which" in text.stderr
    assert "rover/State = 0 (Offline)" in text.stdout
    speed = site.run("read", "rover/speed", "--json").objects[0]
    assert (speed["unit"], speed["node_id"]) == ("m/s", "ns=2;i=1002")


@pytest.mark.parametrize(
    ("pattern", "names"),
    [
        ("rover.*.goal", ["rover/goal"]),
        ("r*/?oal", ["rover/goal"]),
        ("**.x", ["rover/pose/x"]),
        ("Fleet/Robots/*/pose/*", ["Fleet/Robots/rover/pose/x", "Fleet/Robots/rover/pose/frame"]),
        ("*.pose", ["rover/pose/x", "rover/pose/frame"]),
        ("floor.Kind", ["floor.Kind"]),
        ("floor.?ind", []),
        ("Fleet.Bridges.*.Online", ["Fleet/Bridges/floor/Online"]),
        ("rover.speed.Eng*Units", []),
        ("rover.speed.EngineeringUnits", ["rover.speed.EngineeringUnits"]),
    ],
)
def test_patterns_name_values(site: Site, pattern: str, names: list[str]) -> None:
    ended = site.run("read", pattern, "--json", user="olga")
    assert (ended.code, [one["node"] for one in ended.objects]) == (0 if names else 3, names), ended.stderr


def test_what_nothing_matches_is_said(site: Site) -> None:
    ended = site.run("watch", "rover", "*.batery", user="olga")
    assert (ended.code, ended.stdout) == (3, "")
    assert "no value has a name like '*.batery'; look with: ua-fleet browse Fleet/Robots" in ended.stderr


def test_a_long_array_is_cut_for_people_and_whole_for_programs(site: Site) -> None:
    site.run("write", STEPS, json.dumps(list(range(1000))))
    assert "steps = [0, 1, 2, 3, 4, 5, 6, 7, … 1,000 elements]  20" in site.run("read", "rover.steps").stdout
    assert " 999]" in site.run("read", "rover.steps", "--full").stdout
    assert site.run("read", "rover.steps", "--json").objects[0]["value"] == list(range(1000))


@pytest.mark.parametrize(
    ("node", "given", "value"),
    [(GOAL, "0.25", 0.25), (GOAL, "-1", -1.0), (NAME, "a b ü", "a b ü"), (STEPS, "[1, -2, 3]", [1, -2, 3])],
)
def test_write(site: Site, node: str, given: str, value: Any) -> None:
    ended = site.run("write", "--json", "--", node, given)
    assert ended.code == 0, ended.stderr
    assert ended.objects[0]["value"] == value
    assert ended.objects[0]["status"] == "Good"
    assert site.run("read", node, "--json").objects[0]["value"] == value


REFUSED = [
    (("write", GOAL, "2"), 1, "BadOutOfRange: the value is outside the node's range"),
    (("write", GOAL, "fast"), 2, "'fast' is no Double; give a number"),
    (("write", STEPS, "7"), 2, "give it as JSON, such as [1, 2]"),
    (("write", STEPS, "[1, 2.5]"), 2, "'2.5' is no Int32; give a whole number"),
    (("write", SPEED, "1"), 1, "BadNotWritable: clients may not write this node"),
    (("read", "ua_2_2_4000"), 3, "there is no node ua_2_2_4000; look with: ua-fleet browse"),
    (("read", "Hall/Robts"), 3, "there is no 'Robts' below Hall; look with: ua-fleet browse Hall"),
    (("read", "ns=x;i=1"), 3, "look with: ua-fleet browse"),
    (("read", "rover/Skills"), 3, "rover/Skills has no value; look below it with: ua-fleet browse rover/Skills"),
    (("watch", "ua_2_2_4000"), 3, "there is no node ua_2_2_4000"),
    (("write", "ua_2_2_4000", "1"), 3, "BadNodeIdUnknown"),
]


@pytest.mark.parametrize(("arguments", "code", "said"), REFUSED)
def test_what_is_refused_is_one_line(site: Site, arguments: tuple[str, ...], code: int, said: str) -> None:
    ended = site.run(*arguments)
    assert (ended.code, ended.stdout) == (code, ""), ended.stderr
    assert said in ended.stderr
    assert ended.stderr.count("\n") == 1


def test_an_observer_may_not_write(site: Site) -> None:
    ended = site.run("write", GOAL, "0", user="olga")
    assert ended.code == 1
    assert "BadUserAccessDenied" in ended.stderr
    assert "ua-fleet user list" in ended.stderr


def test_who_does_not_get_in(site: Site) -> None:
    ended = site.run("read", GOAL, password="wrong password")
    assert (ended.code, ended.stdout) == (1, "")
    assert "BadUserAccessDenied: user or password is wrong" in ended.stderr
    ended = site.run("read", GOAL, user=None)
    assert ended.code == 1
    assert "the server wants a user and a password; log in: ua-fleet login --user NAME" in ended.stderr
    ended = site.run("read", GOAL, "--insecure")
    assert ended.code != 0


@pytest.mark.parametrize("policy", ["Aes128Sha256RsaOaep", "Aes256Sha256RsaPss"])
def test_other_policies(site: Site, policy: str) -> None:
    assert site.run("read", GOAL, "--policy", policy).code == 0


def test_a_server_with_another_certificate_is_refused(site: Site) -> None:
    known = site.folder / "state-of-client" / "ua-fleet" / "client" / "servers.json"
    before = known.read_text()
    mark = json.loads(before)["servers"][0]["thumbprint"]
    known.write_text(before.replace(mark, "0" * 40))
    ended = site.run("read", GOAL)
    known.write_text("{")
    broken = site.run("read", GOAL)
    known.write_text(before.replace(mark, "0" * 40))
    told = ended.stderr.rpartition("run: ua-fleet ")[2].split()
    forgotten = site.run(*told, user=None)
    anew = site.run("read", GOAL)
    known.write_text(before)
    assert ended.code == 1
    assert "shows another certificate" in ended.stderr
    assert told[:2] == ["cert", "forget"]
    assert (forgotten.code, anew.code) == (0, 0)
    assert "0" * 40 in forgotten.stdout
    assert "first meeting" in anew.stderr
    assert broken.code == 1
    assert "cannot be read" in broken.stderr


def test_watch_ends_by_count_and_by_time(site: Site) -> None:
    site.run("write", GOAL, "0.5")
    ended = site.run("watch", GOAL, "--count", "1", "--timeout", "20", "--json")
    assert (ended.code, [change["value"] for change in ended.objects]) == (0, [0.5])
    ended = site.run("watch", GOAL, "--count", "2", "--timeout", "4.5")
    assert ended.code == 5
    assert ended.stdout.startswith(f"{GOAL} = 0.5")
    assert "2 values did not come within 4.5 s" in ended.stderr
    assert site.run("watch", GOAL, "--timeout", "4.5").code == 0


def test_watch_counts_the_values_that_it_shows(site: Site) -> None:
    read = site.run("read", "rover")
    assert "have never come" in read.stderr
    count = len(read.stdout.splitlines())
    ended = site.run("watch", "rover", "--count", str(count), "--timeout", "20")
    assert (ended.code, len(ended.stdout.splitlines())) == (0, count), ended.stderr


def test_watch_shows_each_change_until_ctrl_c(site: Site) -> None:
    child = site.start("watch", GOAL)
    child.wait_for(f"{GOAL} = ")
    site.run("write", GOAL, "0.125")
    child.wait_for(f"{GOAL} = 0.125")
    assert child.end(signal.SIGINT) == 130
    assert not any("Traceback" in line for line in child.lines)


async def test_a_robots_values_arrive_and_go_bad_with_their_source(site: Site) -> None:
    child = site.start("watch", SPEED, "ns=2;s=1006.x", "ns=2;s=1006.frame")
    topic, pose = Topic.parse(SPEED), Topic.parse(POSE)
    async with Peer.at(site.url, space=2) as robot:
        robot.announce(topic, (make_field("speed", BuiltinType.DOUBLE),))
        robot.announce(pose, (make_field("x", BuiltinType.DOUBLE), make_field("frame", BuiltinType.STRING)))
        robot.publish(topic, 1.5)
        robot.publish(pose, 7.25, "map")
        await asyncio.to_thread(child.wait_for, f"{SPEED} = 1.5 m/s  20")
        await asyncio.to_thread(child.wait_for, "ns=2;s=1006.x = 7.25")
        await asyncio.to_thread(child.wait_for, 'ns=2;s=1006.frame = "map"')
    await asyncio.to_thread(child.wait_for, f"{SPEED} = 1.5 m/s  BadNoCommunication")
    assert await asyncio.to_thread(child.end, signal.SIGTERM) == 130


async def test_rates_and_a_table(site: Site) -> None:
    topic = Topic.parse(SPEED)
    child = site.start("watch", SPEED, "--rate", "--json", "--timeout", "20")
    async with Peer.at(site.url, space=2) as robot:
        robot.announce(topic, (make_field("speed", BuiltinType.DOUBLE),))
        told: list[Any] = []
        async with asyncio.timeout(60):
            # The same value each time: it counts, since its time is another one.
            while not told or told[-1]["count"] < 10:
                robot.publish(topic, 1.5)
                await asyncio.sleep(0.15)
                told = [json.loads(line) for line in list(child.lines) if line.startswith("{")]
        assert 0 < told[-1]["per_s"] < 10
        assert told[-1]["node"] == SPEED
        table = await asyncio.to_thread(
            site.run, "watch", "rover.speed", "--table", "--age", "--rate", "--count", "1", "--color", "never"
        )
    assert table.code == 0, table.stderr
    heading, row = table.stdout.splitlines()[-3:-1]
    assert heading.split() == ["node", "value", "per", "s", "age", "status"]
    assert row.split()[:3] == ["rover.speed", "1.5", "m/s"]
    await asyncio.to_thread(child.end, signal.SIGINT)


def test_a_table_is_not_for_programs(site: Site) -> None:
    ended = site.run("watch", GOAL, "--table", "--json")
    assert (ended.code, ended.stdout) == (2, "")
    assert "leave one of them out" in ended.stderr


def test_nobody_answers_and_nobody_answers_in_time(site: Site, tcp_port: int) -> None:
    import socket

    ended = site.run("browse", "-e", f"opc.tcp://127.0.0.1:{tcp_port}/ua_fleet")
    assert ended.code == 4
    assert ended.stderr.endswith("start it with: ua-fleet serve\n")
    with socket.create_server(("127.0.0.1", 0)) as deaf:
        ended = site.run("read", GOAL, "-e", f"opc.tcp://127.0.0.1:{deaf.getsockname()[1]}/x", "--timeout", "0.5")
    assert ended.code == 5
    assert "did not answer in time" in ended.stderr


def test_a_port_in_use_is_one_line(site: Site, tmp_path: Path) -> None:
    (tmp_path / "fleet.yaml").write_text((site.folder / "fleet.yaml").read_text())
    ended = site.run("serve", "-c", str(tmp_path / "fleet.yaml"), user=None)
    assert ended.code not in (0, 130)
    last = ended.stderr.strip().splitlines()[-1]
    assert "in use" in last


def test_a_second_server_in_one_folder_is_one_line(site: Site) -> None:
    ended = site.run("serve", user=None)
    assert ended.code not in (0, 130)
    assert (
        "runs already; stop that process, or give this one a state_dir of its own"
        in ended.stderr.strip().splitlines()[-1]
    )


@pytest.mark.parametrize("way", ["--rate", "--table"])
def test_watch_ends_where_nobody_reads_what_it_tells(site: Site, way: str) -> None:
    watching = forked(*command("watch", GOAL, way), env=site.environment())
    assert watching.stderr is not None
    try:
        assert watching.stdout.readline()
        watching.stdout.close()
        assert watching.wait(20) == 1
        assert watching.stderr.read() == ""
    finally:
        watching.kill()
        watching.wait()
        watching.close()


def test_structures_are_shown_by_their_fields(site: Site) -> None:
    ended = site.run("read", "Fleet/Summaries/1", "Fleet/Summaries/2", "--json", user="olga")
    assert ended.code == 0, ended.stderr
    first, second = ended.objects
    (rover,) = first["value"]
    assert (rover["Name"], rover["Capacities"], rover["Bridge"]) == ("rover", ["mobile"], "floor")
    assert rover["Quality"] in ("BadWaitingForInitialData", "BadNoCommunication", "Good")  # as other tests left it
    assert rover["State"] in (0, 1)
    assert datetime.fromisoformat(rover["StateSince"]).tzinfo is not None
    assert second["value"] == []
    text = site.run("read", "Fleet/Summaries/1", user="olga").stdout
    assert text.startswith('Fleet/Summaries/1 = [{Name: "rover", State: ')
    watched = site.run("watch", "Fleet/Summaries/1", "--count", "1", "--json", user="olga")
    assert watched.objects[0]["value"][0]["Name"] == "rover"
