"""The demonstrations in containers, by what their conductors write."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, Final

__all__ = ["TASKS", "brokered_problems", "pal_problems", "talkrobots_problems"]

TASKS: Final = ("fetch", "transport", "grasp", "approach", "take_off", "pick_left", "bring", "land", "load")
_FLIGHTS: Final = ("take_off", "forth", "land", "back")
_IN_ORDER: Final = ("fetch", "transport", "grasp", "approach", "pick_left", "bring")
_LAST: Final = ("land", "load")
_REPLACED: Final = ("approach", "bring")
_REFUSED: Final = ("not_secured", "bad_signature", "replayed", "unknown_token", "no_key", "secured")


def pal_problems(report: dict[str, Any]) -> list[str]:
    """What is wrong with the line's result; see tests/e2e/test_pal.py."""
    found: list[str] = []

    def check(holds: bool, problem: str) -> None:
        if not holds:
            found.append(problem)

    covers = report["covers"]
    carriers = [cover["carrier"] for cover in covers]
    check(carriers == ["conveyor", "conveyor", "turtlebot3", "turtlebot3"], f"the covers went by {carriers}")
    if len(covers) == 4:
        check(covers[1]["placed_s"] < 25 < covers[2]["placed_s"], "the belt did not stop between two covers and two")
        delivered = all(cover["delivered_s"] is not None for cover in covers)
        check(delivered, "a cover was not delivered")
        if delivered:
            check(
                all(cover["placed_s"] < cover["delivered_s"] for cover in covers), "a cover came before it was placed"
            )
            check(covers[3]["placed_s"] > covers[2]["delivered_s"], "the last cover did not wait for the TurtleBot3")
    check(report["looped"] == 0, f"{report['looped']} messages came round again")
    check(report["secure"] is True, "messages were not secured")
    check(report["ros1"] is True, "there was no ROS 1")
    for way in ("ros1_to_ros2", "ros1_to_server", "ros2_to_server"):
        check(report["delays_ms"].get(way, {}).get("p50", 0) > 0, f"no delay of {way}")
    refused = {cause: count for cause, count in report["drops"].items() if cause in _REFUSED and count}
    check(not refused, f"messages were refused: {refused}")
    return found


def talkrobots_problems(report: dict[str, Any]) -> list[str]:
    """What is wrong with the result of the nine tasks, with automatic resilience; see tests/e2e/test_talkrobots.py."""
    found: list[str] = []

    def check(holds: bool, problem: str) -> None:
        if not holds:
            found.append(problem)

    rows = report["tasks"]
    check(sorted(row["task"] for row in rows) == sorted(TASKS), f"tasks: {[row['task'] for row in rows]}")
    not_done = [f"{row['task']} {row['state']}" for row in rows if row["state"] != "done"]
    check(not not_done, f"not done: {not_done}")
    by_task = {row["task"]: row for row in rows}
    if not found:
        late = [f"{b} before {a}" for a, b in pairwise(_IN_ORDER) if by_task[a]["ended_s"] > by_task[b]["started_s"]]
        check(not late, f"order: {late}")
        for task in _LAST:
            check(by_task[task]["started_s"] >= by_task["bring"]["ended_s"], f"order: {task} before bring")
        check(by_task["load"]["robot"] == "ridgeback", f"load was done by {by_task['load']['robot']}")
    fault: dict[str, Any] = report["fault"] or {}
    check(fault.get("robot") == "ridgeback" and fault.get("task") == "approach", f"the fault: {fault}")
    ranking: list[str] = [place["robot"] for place in fault.get("ranking", ())]
    check(sorted(ranking) == ["pioneer_1", "pioneer_2"], f"the ranking: {ranking}")
    check(fault.get("replacement") == (ranking or [""])[0], f"{fault.get('replacement')} took over, of {ranking}")
    for task in _REPLACED:
        robot = by_task.get(task, {}).get("robot")
        check(robot == fault.get("replacement"), f"{task} was done by {robot}")
    check(0 < fault.get("consistency_ratio", 0) <= 0.1, "the judgements are not consistent")
    messages = report["messages"]
    check(messages.get("request", 0) >= 22 and messages.get("response", 0) >= 22, f"messages: {messages}")
    check(messages.get("sensor", 0) > 0, "the sensor was not heard")
    return found


def brokered_problems(report: dict[str, Any]) -> list[str]:
    """What is wrong with the result of the flights in two halls."""
    rows = report["tasks"]
    found = [f"{row['task']} {row['state']}" for row in rows if row["state"] != "done"]
    if sorted(row["task"] for row in rows) != sorted(_FLIGHTS):
        found.append(f"tasks: {[row['task'] for row in rows]}")
    return found
