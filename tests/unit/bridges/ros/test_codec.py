"""What the encoder takes beside the exact types: the same that the writers of message objects take."""

from __future__ import annotations

import pytest
from ua_bridges.ros.codec import compile_encoder
from ua_bridges.ros.errors import ConversionError
from ua_bridges.ros.leaves import leaves_of
from ua_bridges.ros.schema import MessageSchema, schema_from_definition, schema_from_ros2

BESIDE_AN_ARRAY = {"count": "int32", "level": "octet", "covariance": "double[2]"}
ARRAYS = {"fixed": "int16[2]", "free": "sequence<int64>", "points": "sequence<p/Point>"}
POINT = {"x": "uint8", "y": "double"}


def schemas(types: dict[str, str]) -> list[MessageSchema]:
    """The same type in both ROS."""
    ros1 = {"octet": "byte", "double": "float64", "double[2]": "float64[2]", "sequence<int64>": "int64[]"}
    lines = "".join(f"{ros1.get(kind, kind)} {name}\n" for name, kind in types.items())
    lines = lines.replace("sequence<p/Point>", "Point[]")
    definition = f"{lines}===\nMSG: p/Point\nuint8 x\nfloat64 y\n"
    both = {"p/T": types, "p/Point": POINT}
    return [schema_from_definition("p/T", definition), schema_from_ros2("p/T", both.__getitem__)]


@pytest.mark.parametrize(
    ("types", "exact", "given"),
    [
        (BESIDE_AN_ARRAY, (5, 200, (1.0, 2.0)), (5.0, 200.0, (1, 2))),
        (
            ARRAYS,
            ((1, -2), (1 << 40, 7), (1, 255), (0.5, 2.0)),
            ((1.0, -2), (float(1 << 40), 7), (1.0, 255.0), (0.5, 2)),
        ),
    ],
    ids=["beside_an_array", "in_arrays"],
)
def test_a_float_without_a_fraction_is_an_integer(
    types: dict[str, str], exact: tuple[object, ...], given: tuple[object, ...]
) -> None:
    for schema in schemas(types):
        encode = compile_encoder(schema, [leaf.name for leaf in leaves_of(schema)], lambda _values: None)
        assert encode is not None
        assert encode(given) == encode(exact)


@pytest.mark.parametrize(
    ("types", "given"),
    [
        (BESIDE_AN_ARRAY, (5.5, 200, (1.0, 2.0))),
        (BESIDE_AN_ARRAY, (5.0, 256.0, (1.0, 2.0))),
        (BESIDE_AN_ARRAY, (True, 200, (1.0, 2.0))),
        (ARRAYS, ((1.5, 2), (), (), ())),
        (ARRAYS, ((1, 40_000.0), (), (), ())),
        (ARRAYS, ((1, 2), (1.5,), (), ())),
        (ARRAYS, ((1, 2), (2.0**63,), (), ())),
    ],
)
def test_what_is_no_integer_is_refused(types: dict[str, str], given: tuple[object, ...]) -> None:
    for schema in schemas(types):
        encode = compile_encoder(schema, [leaf.name for leaf in leaves_of(schema)], lambda _values: None)
        assert encode is not None
        with pytest.raises(ConversionError):
            encode(given)
