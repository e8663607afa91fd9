"""Pictures in ByteStrings, as cameras tell them.

`sensor_msgs/CompressedImage` is known by its first bytes. Of `sensor_msgs/Image` the other fields say how its bytes are
to be read; the page does that, so that a camera costs the console no more than the bytes themselves.
"""

from __future__ import annotations

from typing import Final

__all__ = ["MOST_BYTES", "picture_type"]

MOST_BYTES: Final = 4 * 1024 * 1024
"""A picture up to this size is shown."""
_JPEG: Final = b"\xff\xd8\xff"
_PNG: Final = b"\x89PNG\r\n\x1a\n"


def picture_type(content: bytes) -> str | None:
    """The media type of a picture that each browser shows; None: it is none."""
    if content.startswith(_JPEG):
        return "image/jpeg"
    if content.startswith(_PNG):
        return "image/png"
    if content[:4] == b"RIFF" and content[8:12] == b"WEBP":
        return "image/webp"
    return None
