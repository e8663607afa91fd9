"""What stands beside the words of carried runs that are no part and no token; see `pubsub.carry_action`."""

from __future__ import annotations

import json
from typing import Any, Final

from ua_fleet.document import as_mapping
from ua_fleet.errors import ScenarioError
from ua_fleet.values import StatusCode

__all__ = ["WordsInvalid", "decode_words", "encode_words"]

_MOST_JSON_BYTES: Final = 4000


class WordsInvalid(ScenarioError):
    """What came as words is none."""

    ua_status = StatusCode.BAD_INVALID_ARGUMENT
    remedy = "Run the same version of ua-fleet in the server and in the bridges."


def encode_words(**words: Any) -> bytes:
    """Names with their values, as JSON."""
    return json.dumps(words, ensure_ascii=False, separators=(",", ":")).encode()


def decode_words(content: bytes, *, most: int = _MOST_JSON_BYTES) -> dict[str, Any]:
    """The same as somebody has sent it, of at most so many bytes; raises WordsInvalid."""
    try:
        words: Any = json.loads(content[:most])
    except (ValueError, RecursionError) as error:
        raise WordsInvalid("the content of a word of carried runs cannot be read") from error
    return as_mapping(words) or {}
