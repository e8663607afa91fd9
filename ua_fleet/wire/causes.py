"""Why a message of a peer was not decoded: the counters that drops go to."""

from __future__ import annotations

from enum import StrEnum

from ua_fleet.errors import RemoteWireError

__all__ = ["Cause", "SecuredMessage"]


class Cause(StrEnum):
    """The `cause` of every RemoteWireError that this package raises. The values are the names that operators see."""

    TRUNCATED = "truncated"
    """The bytes end before the message does."""
    LENGTH_BEYOND_END = "length_beyond_end"
    """A length or count announces more than the bytes that are left can hold."""
    NEGATIVE_LENGTH = "negative_length"
    """A length below -1, which stands for null."""
    TOO_DEEP = "too_deep"
    """Values nested deeper than we follow."""
    INVALID_UTF8 = "invalid_utf8"
    """A String that is not UTF-8."""
    TRAILING_BYTES = "trailing_bytes"
    """Bytes other than zero padding after the end of a message."""

    UADP_VERSION = "uadp_version"
    """Another version of UADP than 1."""
    RESERVED_PUBLISHER_ID_TYPE = "reserved_publisher_id_type"
    RESERVED_EXTENDED_FLAGS = "reserved_extended_flags"
    RESERVED_MESSAGE_TYPE = "reserved_message_type"
    """A NetworkMessage type other than DataSetMessage payload, probe and announcement."""
    RESERVED_GROUP_FLAGS = "reserved_group_flags"
    SECURED = "secured"
    """A signed or encrypted message that was not opened with its key."""
    SECURITY_FLAGS = "security_flags"
    """Reserved SecurityFlags, or encryption, a footer or a key reset without a signature."""
    NONCE_LENGTH = "nonce_length"
    """Another length of the MessageNonce than AES-CTR has."""
    SECURITY_FOOTER = "security_footer"
    """A security footer larger than the message that it ends."""
    SIGNATURE = "signature"
    """A signature that was not made with this key over these bytes."""
    CHUNK = "chunk"
    """A part of a message that was not put together with the others."""
    CHUNK_EMPTY = "chunk_empty"
    """A chunk without data."""
    CHUNK_RANGE = "chunk_range"
    """A chunk that reaches beyond the TotalSize that it announces."""
    CHUNK_OVERLAPS = "chunk_overlaps"
    """A chunk with bytes that another one has brought; the message is given up."""
    CHUNK_CONTRADICTS = "chunk_contradicts"
    """A chunk with another TotalSize or other headers than the others of its message, which is given up."""
    CHUNK_TOO_LARGE = "chunk_too_large"
    """A chunk of a message that is larger than we put together."""
    ACTION = "action"
    """An Action message: not decoded yet."""
    NO_DATA_SET_MESSAGE = "no_data_set_message"
    """A payload header with a count of 0."""
    PROMOTED_COUNT = "promoted_count"
    """Promoted fields in a NetworkMessage that does not carry exactly one DataSetMessage."""
    PROMOTED_SIZE = "promoted_size"
    """The promoted fields do not end where their size says."""

    RESERVED_FIELD_ENCODING = "reserved_field_encoding"
    RESERVED_DATA_SET_FLAGS = "reserved_data_set_flags"
    RESERVED_FRAME_KIND = "reserved_frame_kind"
    EVENT_ENCODING = "event_encoding"
    """An event whose fields are not Variants."""
    REPEATED_FIELD_INDEX = "repeated_field_index"
    """A delta frame that names a field twice."""

    VARIANT_TYPE = "variant_type"
    """A Variant of a type that does not exist."""
    VARIANT_IN_VARIANT = "variant_in_variant"
    """A scalar Variant in a Variant; only arrays of Variant may stand there."""
    DIMENSIONS_WITHOUT_ARRAY = "dimensions_without_array"
    ARRAY_DIMENSIONS = "array_dimensions"
    """Dimensions whose product is not the length of the array."""
    NODE_ID_ENCODING = "node_id_encoding"
    EXTENSION_OBJECT_ENCODING = "extension_object_encoding"
    RESERVED_MASK_BITS = "reserved_mask_bits"
    """A reserved bit in the mask of a LocalizedText, DataValue or DiagnosticInfo."""

    DISCOVERY_FLAGS = "discovery_flags"
    """A discovery message with header flags that it must not have."""
    PROBE_TYPE = "probe_type"
    """A probe of a kind that is not answered."""
    ANNOUNCEMENT_TYPE = "announcement_type"
    """An announcement of a reserved type."""
    ANNOUNCEMENT_COUNTS = "announcement_counts"
    """An announcement with two lists that should have the same length, and have not."""

    RAW_TYPE = "raw_type"
    """RawData with a field of a type that cannot be encoded so."""
    RAW_RANK = "raw_rank"
    """RawData with a field whose rank its metadata leaves open."""
    RAW_TOO_LONG = "raw_too_long"
    """RawData with a string or an array beyond the maximum of its metadata."""
    RAW_PADDING = "raw_padding"
    """RawData whose padding is not zero."""
    RAW_FIELD_INDEX = "raw_field_index"
    """A RawData delta frame with a field that its metadata does not have."""


class SecuredMessage(RemoteWireError):
    """A message with the security flag: dropped, never read as data."""

    def __init__(self, detail: str, offset: int = -1) -> None:
        super().__init__(Cause.SECURED, detail, offset)
