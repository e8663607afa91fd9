from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ua_demo.simulators.ur.controller import Controller, Settings
from ua_demo.simulators.ur.functions import functions_of
from ua_demo.simulators.ur.kinematics import MODELS
from ua_demo.simulators.ur.rtde import ProtocolError, RtdeInputs, RtdeSession
from ua_demo.simulators.ur.variables import INPUTS, OUTPUTS, TYPES


def package(kind: str, payload: bytes = b"") -> bytes:
    return struct.pack(">HB", 3 + len(payload), ord(kind)) + payload


def parts(data: bytes) -> list[tuple[str, bytes]]:
    found: list[tuple[str, bytes]] = []
    while data:
        (size,) = struct.unpack_from(">H", data)
        found.append((chr(data[2]), data[3:size]))
        data = data[size:]
    return found


def outputs(frequency: float, *names: str) -> bytes:
    return package("O", struct.pack(">d", frequency) + ",".join(names).encode())


class Line:
    """A session with its controller."""

    def __init__(self, inputs: RtdeInputs | None = None, controller: Controller | None = None) -> None:
        self.controller = controller or Controller(Settings(MODELS["ur5e"]), functions_of)
        self.inputs = inputs or RtdeInputs()
        self.session = RtdeSession(self.controller, self.inputs)

    def ask(self, data: bytes) -> list[tuple[str, bytes]]:
        return parts(self.session.receive(data))

    def negotiated(self) -> Line:
        assert self.ask(package("V", b"\x00\x02")) == [("V", b"\x01")]
        return self


def test_only_version_2_is_agreed_to() -> None:
    line = Line()
    assert line.ask(package("V", b"\x00\x01")) == [("V", b"\x00")]
    ((kind, text),) = line.ask(outputs(500.0, "timestamp"))
    assert kind == "M"
    assert b"negotiate" in text
    line.negotiated()


def test_controllers_version_is_told() -> None:
    assert Line().ask(package("v")) == [("v", struct.pack(">4I", 5, 12, 4, 1101661))]


def test_output_recipe_names_its_types_and_data_follow_after_the_start() -> None:
    line = Line().negotiated()
    (answer,) = line.ask(outputs(500.0, "timestamp", "actual_q", "robot_mode", "actual_digital_output_bits"))
    assert answer == ("O", b"\x01DOUBLE,VECTOR6D,INT32,UINT64")
    assert line.session.due(0) == b""
    assert line.ask(package("S")) == [("S", b"\x01")]
    line.controller.digital_outputs = 0b101
    line.controller.step()
    ((kind, payload),) = parts(line.session.due(1))
    assert (kind, payload[0]) == ("U", 1)
    time, *q, mode, bits = struct.unpack(">d6diQ", payload[1:])
    assert (time, q, mode, bits) == (0.002, line.controller.arm.q, 3, 5)
    assert line.ask(package("P")) == [("P", b"\x01")]
    assert line.session.due(2) == b""


@pytest.mark.parametrize(("frequency", "each_second"), [(500.0, 500), (125.0, 125), (10.0, 10), (1.0, 1)])
def test_data_come_as_often_as_asked(frequency: float, each_second: int) -> None:
    line = Line().negotiated()
    line.ask(outputs(frequency, "timestamp") + package("S"))
    assert sum(bool(line.session.due(cycle)) for cycle in range(500)) == each_second


@pytest.mark.parametrize(
    ("asked", "answer"),
    [
        (outputs(500.0, "timestamp", "warp"), b"\x00DOUBLE,NOT_FOUND"),
        (outputs(501.0, "timestamp"), b"\x00DOUBLE"),
        (outputs(float("nan"), "timestamp"), b"\x00DOUBLE"),
        (outputs(0.0, "timestamp"), b"\x00DOUBLE"),
        (package("O", b"\x00"), b"\x00NOT_FOUND"),
    ],
)
def test_recipe_that_cannot_be_is_number_0(asked: bytes, answer: bytes) -> None:
    line = Line().negotiated()
    assert line.ask(asked) == [("O", answer)]
    assert line.ask(package("S")) == [("S", b"\x00")]


def test_every_variable_has_a_value_of_its_type() -> None:
    line = Line().negotiated()
    for name, output in OUTPUTS.items():
        (answer,) = line.ask(outputs(500.0, name))
        assert answer == ("O", b"\x01" + output.type.encode())
        line.ask(package("S"))
        ((_, payload),) = parts(line.session.due(0))
        assert len(payload) - 1 == struct.calcsize(">" + TYPES[output.type])


def test_inputs_are_written_by_their_recipe() -> None:
    line = Line().negotiated()
    first = line.ask(package("I", b"input_int_register_3,input_double_register_7"))
    second = line.ask(package("I", b"speed_slider_mask,speed_slider_fraction"))
    assert (first, second) == ([("I", b"\x01INT32,DOUBLE")], [("I", b"\x02UINT32,DOUBLE")])
    assert line.ask(package("U", struct.pack(">Bid", 1, -5, 0.25))) == []
    assert line.ask(package("U", struct.pack(">BId", 2, 1, 0.5))) == []
    assert (line.controller.inputs.ints[3], line.controller.inputs.doubles[7]) == (-5, 0.25)
    assert line.controller.speed_slider == 0.5


@pytest.mark.parametrize("fraction", [-0.1, 1.1, float("nan")])
def test_speed_slider_stays_within_its_range(fraction: float) -> None:
    line = Line().negotiated()
    line.ask(package("I", b"speed_slider_mask,speed_slider_fraction"))
    line.ask(package("U", struct.pack(">BId", 1, 1, fraction)))
    assert line.controller.speed_slider == 1.0


def test_digital_outputs_change_where_the_mask_says_so() -> None:
    line = Line().negotiated()
    line.ask(package("I", b"configurable_digital_output_mask,configurable_digital_output"))
    line.controller.digital_outputs = 0x1FFFF
    line.ask(package("U", struct.pack(">BBB", 1, 0b11, 0b01)))
    assert line.controller.digital_outputs == 0x1FFFF & ~0x200


def test_input_that_another_client_has_is_in_use_until_it_leaves() -> None:
    first = Line().negotiated()
    second = Line(first.inputs, first.controller).negotiated()
    first.ask(package("I", b"input_int_register_0"))
    assert first.ask(package("I", b"input_int_register_0"))[0][1][:1] == b"\x02"
    assert second.ask(package("I", b"input_int_register_0,warp")) == [("I", b"\x00IN_USE,NOT_FOUND")]
    first.session.close()
    assert second.ask(package("I", b"input_int_register_0")) == [("I", b"\x01INT32")]


@pytest.mark.parametrize(
    ("data", "text"), [(package("U", b"\x01"), b"no input recipe 1"), (package("X"), b"no package of type")]
)
def test_what_makes_no_sense_is_told(data: bytes, text: bytes) -> None:
    ((kind, said),) = Line().negotiated().ask(data)
    assert kind == "M"
    assert text in said


def test_message_of_another_size_than_its_recipe_is_told() -> None:
    line = Line().negotiated()
    line.ask(package("I", b"input_int_register_0"))
    ((kind, said),) = line.ask(package("U", b"\x01\x00"))
    assert kind == "M"
    assert b"4 bytes" in said


def test_package_without_its_own_header_ends_the_session() -> None:
    with pytest.raises(ProtocolError):
        Line().ask(b"\x00\x02V\x00")


@given(st.binary(max_size=300), st.integers(1, 40))
def test_whatever_comes_only_a_protocol_error_goes_out(data: bytes, cut: int) -> None:
    line = Line().negotiated()
    line.ask(package("I", b"input_int_register_0,input_bit_registers0_to_31"))
    try:
        for at in range(0, len(data), cut):
            line.session.receive(data[at : at + cut])
    except ProtocolError:
        pass


def test_every_input_has_a_type() -> None:
    line = Line().negotiated()
    for name, declared in INPUTS.items():
        assert line.ask(package("I", name.encode()))[0][1][1:] == declared.type.encode()
        line.session.close()
        line.session = RtdeSession(line.controller, line.inputs)
        line.negotiated()
