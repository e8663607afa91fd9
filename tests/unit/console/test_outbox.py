"""What reaches a browser: whatever happens in which order, in the end its maps are the boards'."""

from __future__ import annotations

import json
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from ua_fleet.console.board import Board, encoded
from ua_fleet.console.outbox import FEW_CHARACTERS, LEAST_INTERVAL_S, MOST_CHARACTERS, MOST_INTERVAL_S, PageOutbox

KEYS = st.sampled_from(["a", "b", "c", "\u202e", 'q"'])
NAMES = st.sampled_from(["1", "2"])
MEMBERS: st.SearchStrategy[Any] = st.one_of(st.integers(0, 2), st.booleans(), st.lists(st.integers(0, 1), max_size=1))
VALUES: st.SearchStrategy[Any] = st.one_of(
    st.integers(0, 3),
    st.fixed_dictionaries({'q"': MEMBERS, "same": st.just("x"), "t": MEMBERS}, optional={"seldom": st.none()}),
)
ACTIONS = st.one_of(
    st.tuples(st.just("put"), NAMES, KEYS, VALUES),
    st.tuples(st.just("gone"), NAMES, KEYS),
    st.tuples(st.just("restart"), NAMES),
    st.tuples(st.just("ready"), NAMES),
    st.tuples(st.just("fail"), NAMES, st.integers(0, 3)),
    st.tuples(st.just("want"), NAMES),
    st.tuples(st.just("drop"), NAMES),
    st.tuples(st.just("send")),
    st.tuples(st.just("seen")),
    st.tuples(st.just("pass"), st.floats(0, 0.2)),
)


class Page:
    """A browser: what it has been told, put together as `web/src/lib/live.svelte.ts` does."""

    def __init__(self) -> None:
        self.maps: dict[str, dict[str, Any]] = {}
        self.errors: dict[str, Any] = {}
        self.unseen = 0

    def take(self, text: str) -> None:
        message = json.loads(text)
        self.unseen = message["n"]
        for name, told in message["feeds"].items():
            if told.get("whole"):
                self.maps[name] = {}
            self.maps.get(name, {}).update(told.get("set", {}))
            for key, part in told.get("part", {}).items():
                assert self.maps[name][key].keys() >= part.keys()
                self.maps[name][key] = self.maps[name][key] | part
            for key in told.get("gone", ()):
                self.maps[name].pop(key, None)  # it may have come and gone meanwhile
            if "error" in told:
                self.errors[name] = told["error"]

    def forget(self, name: str) -> None:
        """It shows an error of before until it is told another, or that there is none."""
        self.maps.pop(name, None)


def change(board: Board, action: str, *given: Any) -> None:
    if action == "fail":
        board.fail({"message": given[0]})
    else:
        getattr(board, action)(*given)


@settings(max_examples=400)
@given(st.lists(ACTIONS, max_size=60), st.sampled_from([1, 5, MOST_CHARACTERS]))
def test_after_the_last_confirmation_the_page_has_what_the_boards_have(
    actions: list[tuple[Any, ...]], most_characters: int
) -> None:
    boards, outbox, page = {"1": Board(), "2": Board()}, PageOutbox(most_characters=most_characters), Page()
    wanted: set[str] = set()
    now, sent_at = 100.0, float("-inf")

    def send() -> bool:
        nonlocal sent_at
        text = outbox.next(now)
        if text is None:
            return False
        assert page.unseen == 0, "a second message is under way"
        assert now - sent_at >= LEAST_INTERVAL_S - 1e-9, "too soon"
        sent_at = now
        page.take(text)
        return True

    def confirm() -> None:
        if page.unseen:
            assert outbox.seen(page.unseen)
            page.unseen = 0
        else:
            assert not outbox.seen(7)

    for action, *rest in actions:
        if action == "want":
            outbox.want(rest[0], boards[rest[0]])
            wanted.add(rest[0])
            page.forget(rest[0])
        elif action == "drop":
            outbox.drop(rest[0])
            wanted.discard(rest[0])
        elif action == "send":
            send()
        elif action == "seen":
            confirm()
        elif action == "pass":
            now += rest[0]
        else:
            change(boards[rest[0]], action, *rest[1:])

    for board in boards.values():
        board.ready()
    confirm()
    now += 1.0
    while send():
        confirm()
        now += 1.0
    for name in wanted:
        # As texts: to Python, true is 1.
        assert {key: encoded(one) for key, one in page.maps[name].items()} == dict(boards[name].items())
        assert page.errors.get(name) == (json.loads(boards[name].error) if boards[name].error else None)
    due_s = outbox.due_s(now)
    assert due_s is not None
    assert LEAST_INTERVAL_S < due_s <= MOST_INTERVAL_S  # nothing waits


def test_a_browser_that_confirms_hears_something_each_5_s() -> None:
    outbox = PageOutbox()
    first = outbox.next(100.0, "2026-11-23T22:00:00.000Z")
    assert first == '{"n":1,"feeds":{},"now":"2026-11-23T22:00:00.000Z"}'
    assert outbox.due_s(200.0) is None  # it stands
    outbox.seen(1)
    assert outbox.next(104.9) is None
    assert outbox.due_s(104.0) == 1.0
    assert outbox.next(105.0) is not None


@given(st.integers(1, 200))
def test_keys_that_come_and_go_take_no_memory(rounds: int) -> None:
    board, outbox = Board(), PageOutbox()
    board.ready()
    outbox.want("1", board)
    assert outbox.next(0.0) is not None  # never confirmed: the browser stands
    for number in range(rounds * 20):
        board.put(f"k{number}", number)
        board.gone(f"k{number}")
    assert outbox.waiting_keys <= 1001
    assert outbox.next(1000.0) is None
    assert outbox.seen(1)
    text = outbox.next(1000.0)
    assert text is not None
    assert "set" not in json.loads(text)["feeds"]["1"] or not json.loads(text)["feeds"]["1"]["set"]


def test_much_that_changed_at_once_comes_in_parts_and_what_waits_for_longest_first() -> None:
    board, outbox = Board(), PageOutbox()
    board.ready()
    outbox.want("1", board)
    assert outbox.next(0.0) is not None
    for number in range(1000):
        board.put(f"robot{number}", {"is": "x" * 65})
    met: list[str] = []
    turn = 0
    while outbox.waiting_keys:
        turn += 1
        assert outbox.seen(turn)
        board.put("robot0", {"is": turn})  # one that changes each time keeps nobody waiting
        text = outbox.next(float(turn))
        assert text is not None
        assert len(text) < 1.6 * FEW_CHARACTERS
        told = json.loads(text)["feeds"]["1"]
        met += [*told.get("set", ()), *told.get("part", ())]
    assert turn * LEAST_INTERVAL_S < 0.75, "a page is behind by this long"
    assert set(met) == {f"robot{number}" for number in range(1000)}
    assert [one for one in met if one != "robot0"] == [f"robot{number}" for number in range(1, 1000)]


def test_where_very_much_waits_a_message_has_more_of_it() -> None:
    board, outbox = Board(), PageOutbox()
    board.ready()
    outbox.want("1", board)
    assert outbox.next(0.0) is not None
    for number in range(10_000):
        board.put(f"robot{number}", {"is": "x" * 65})
    assert outbox.seen(1)
    text = outbox.next(1.0)
    assert text is not None
    assert MOST_CHARACTERS < len(text) < 1.2 * MOST_CHARACTERS


def test_of_a_value_that_the_browser_has_only_what_changed_is_told() -> None:
    board, outbox = Board(), PageOutbox()

    def told(turn: int) -> Any:
        if turn:
            assert outbox.seen(turn)
        text = outbox.next(float(turn))
        assert text is not None
        return json.loads(text)["feeds"]["1"]

    robot = {"name": "arm", "state": {"v": "idle", "s": 0}, "updated": "1"}
    board.put("arm", robot)
    board.ready()
    outbox.want("1", board)
    assert told(0) == {"whole": True, "set": {"arm": robot}, "error": None}
    board.put("arm", robot | {"updated": "2"})
    assert told(1) == {"part": {"arm": {"updated": "2"}}}
    # One that changed twice meanwhile is told whole: the browser has none of the first change.
    board.put("arm", robot | {"state": {"v": "busy", "s": 0}, "updated": "2"})
    board.put("arm", robot | {"state": {"v": "busy", "s": 0}, "updated": "3"})
    assert told(2) == {"set": {"arm": robot | {"state": {"v": "busy", "s": 0}, "updated": "3"}}}
    # A part takes nothing away, and to Python 0 is False.
    board.put("arm", {"name": "arm", "state": 0})
    assert told(3) == {"set": {"arm": {"name": "arm", "state": 0}}}
    board.put("arm", {"name": "arm", "state": False})
    assert told(4) == {"part": {"arm": {"state": False}}}
    board.gone("arm")
    board.put("arm", {"name": "arm", "state": True})
    assert told(5) == {"set": {"arm": {"name": "arm", "state": True}}}


def test_a_page_that_comes_back_is_told_that_the_error_that_it_shows_is_over() -> None:
    """It had the error when its connection was lost, or when its want was refused for want of a login."""
    board, before, page = Board(), PageOutbox(), Page()

    def take(outbox: PageOutbox) -> None:
        text = outbox.next(0.0)
        assert text is not None
        page.take(text)

    board.fail({"message": "a mistake"})
    before.want("1", board)
    take(before)
    assert page.errors["1"] == {"message": "a mistake"}
    before.close()
    board.ready()
    after = PageOutbox()
    after.want("1", board)
    take(after)
    assert page.errors["1"] is None


def test_a_value_is_encoded_once_and_the_same_one_is_no_change() -> None:
    board, heard = Board(), list[str]()

    class Listener:
        def changed(self, key: str, part: str | None) -> None:
            heard.append(key)

        def replaced(self) -> None:
            heard.append("*")

        def failed(self) -> None:
            heard.append("!")

    board.attach(Listener())
    board.put("a", 1)
    assert heard == []
    board.ready()
    board.put("a", 1)
    board.put("a", 2)
    board.gone("b")
    board.fail({"message": "no"})
    board.fail({"message": "no"})
    board.ready()
    assert heard == ["*", "a", "!", "!"]


def test_a_board_has_a_bound() -> None:
    board = Board(most_keys=2)
    for key in "abc":
        board.put(key, 0)
    board.put("a", 1)
    assert (len(board), board.too_many, board.get("a"), board.get("c")) == (2, 1, "1", None)
