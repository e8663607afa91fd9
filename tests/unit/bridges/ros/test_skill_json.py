"""The JSON of robots' own programs."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ua_bridges.ros.skill_json import (
    ProgramState,
    ProgramStatus,
    StatusInvalid,
    cancel_text,
    ended_of,
    execute_text,
    parse_status,
    query_text,
    resume_text,
    suspend_text,
)

from tests.unit.bridges.ros.skill_fakes import spec_of
from ua_fleet.bridge.executing import Ended
from ua_fleet.values import StatusCode

ID = bytes(range(16))
HEX = ID.hex()
SKILL = spec_of(results={"distance": {"type": "Double", "range": (0, 5)}, "stops": {"type": "Int16"}}).config


def test_requests() -> None:
    assert json.loads(execute_text(ID, "drive", {"to": "Tür", "fast": True}, 60.0)) == {
        "request": "execute",
        "execution_id": HEX,
        "skill": "drive",
        "arguments": {"to": "Tür", "fast": True},
        "timeout_s": 60.0,
    }
    assert json.loads(query_text(ID)) == {"request": "query", "execution_id": HEX}
    assert json.loads(suspend_text(ID)) == {"request": "suspend", "execution_id": HEX}
    assert json.loads(resume_text(ID)) == {"request": "resume", "execution_id": HEX}
    assert json.loads(cancel_text(ID)) == {"request": "cancel", "execution_id": HEX}


def test_what_json_has_no_word_for_is_not_written() -> None:
    with pytest.raises(ValueError, match="Out of range"):
        execute_text(ID, "drive", {"to": math.nan}, 60.0)


@pytest.mark.parametrize(
    ("members", "status"),
    [
        ({"state": "accepted"}, ProgramStatus(ID, ProgramState.ACCEPTED)),
        (
            {"state": "running", "progress": 0.5, "message": "half\nway", "newer": 1},
            ProgramStatus(ID, ProgramState.RUNNING, 0.5, {}, "half way"),
        ),
        ({"state": "suspended", "progress": 0.5}, ProgramStatus(ID, ProgramState.SUSPENDED, 0.5)),
        ({"state": "done", "results": {"a": 1}}, ProgramStatus(ID, ProgramState.DONE, 0.0, {"a": 1})),
        ({"state": "failed", "results": None, "message": None}, ProgramStatus(ID, ProgramState.FAILED)),
    ],
)
def test_status(members: dict[str, Any], status: ProgramStatus) -> None:
    assert parse_status(json.dumps({"execution_id": HEX, **members})) == status


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "not JSON"),
        ("[]", "not a JSON object"),
        ("[" * 100_000, "not JSON"),
        ('{"state": "done"}', "execution_id"),
        ('{"execution_id": "0f", "state": "done"}', "32 hexadecimal digits"),
        ('{"execution_id": 5, "state": "done"}', "32 hexadecimal digits"),
        (f'{{"execution_id": "{HEX}", "state": "ready"}}', "`state` is one of accepted, refused"),
        (f'{{"execution_id": "{HEX}", "state": {{}}}}', "`state` is one of"),
        (f'{{"execution_id": "{HEX}", "state": "done", "progress": 2}}', "`progress`"),
        (f'{{"execution_id": "{HEX}", "state": "done", "progress": NaN}}', "`progress`"),
        (f'{{"execution_id": "{HEX}", "state": "done", "results": []}}', "`results`"),
        (f'{{"execution_id": "{HEX}", "state": "done", "message": 5}}', "`message`"),
        (" " * 1_000_001, "1000001 characters"),
    ],
)
def test_texts_that_are_no_status(text: str, said: str) -> None:
    with pytest.raises(StatusInvalid) as caught:
        parse_status(text)
    assert said in str(caught.value)


@given(st.one_of(st.text(), st.dictionaries(st.text(), st.text() | st.floats() | st.none()).map(json.dumps)))
def test_whatever_comes_only_the_one_error_goes(text: str) -> None:
    with pytest.raises(StatusInvalid):
        parse_status(text)


UNFIT = "it is done; its results are not those of the skill: "


@pytest.mark.parametrize(
    ("state", "results", "ended"),
    [
        (ProgramState.DONE, {"distance": 2, "stops": 3.0}, Ended(0, (2.0, 3), "said")),
        (ProgramState.DONE, {"distance": 9.5, "stops": 0, "more": 1}, Ended(0, (9.5, 0), "said")),
        (ProgramState.DONE, {"distance": 2.0}, Ended(StatusCode.UNCERTAIN, (), f"{UNFIT}stops is missing")),
        (
            ProgramState.DONE,
            {"distance": 2.0, "stops": "many"},
            Ended(StatusCode.UNCERTAIN, (), f"{UNFIT}stops is 'many'; it has to be a number"),
        ),
        (ProgramState.REFUSED, {}, Ended(StatusCode.BAD_REQUEST_NOT_ALLOWED, (), "said")),
        (ProgramState.FAILED, {}, Ended(StatusCode.BAD_UNEXPECTED_ERROR, (), "said")),
        (ProgramState.HALTED, {}, Ended(StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT, (), "said")),
    ],
)
def test_ends(state: ProgramState, results: dict[str, Any], ended: Ended) -> None:
    assert ended_of(ProgramStatus(ID, state, 1.0, results, "said"), SKILL) == ended
