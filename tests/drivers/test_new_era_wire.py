"""How a New Era pump writes. The check values are those of its manual and of CRC-16/XMODEM."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import DeviceProtocolError, OutOfVolumeError
from drivers.new_era_wire import basic_packet, crc, four_digits, parse_reply, parse_value, safe_packet


@pytest.mark.parametrize(
    ("data", "value"),
    # The first is printed in the manual (page 33), the last is the check value of the algorithm itself.
    [(b"SAF0", 0x5543), (b"0RUN", 0x4407), (b"0VER", 0x4809), (b"00S", 0xAAA6), (b"123456789", 0x31C3)],
)
def test_the_check_value_is_that_of_the_manual(data: bytes, value: int) -> None:
    assert crc(data) == value


def test_the_packet_that_returns_a_pump_to_basic_mode_is_that_of_the_manual() -> None:
    assert safe_packet("SAF0") == bytes.fromhex("02 08 53 41 46 30 55 43 03")


def test_a_basic_command_ends_with_a_carriage_return() -> None:
    assert basic_packet("0DIA26.59") == b"0DIA26.59\r"


@given(st.floats(min_value=0.0005001, max_value=9999.4))
def test_a_number_has_at_most_four_digits_and_is_as_close_as_they_allow(value: float) -> None:
    text = four_digits(value)
    whole, _, decimals = text.partition(".")
    assert len(whole + decimals) <= 4
    assert len(decimals) <= 3
    # With one digit more the text would be too long: half a step of the last digit is the best there is.
    assert abs(float(text) - value) <= 0.5 * 10.0 ** -len(decimals) * (1 + 1e-9)
    assert len(decimals) == 3 or len(whole + decimals) == 4


@pytest.mark.parametrize("value", [0.0, 0.0004, 9999.6, 12345.0])
def test_a_number_that_would_become_zero_or_needs_five_digits_is_never_written(value: float) -> None:
    with pytest.raises(OutOfVolumeError, match=r"0\.001 to 9999"):
        four_digits(value)


def test_replies_are_taken_apart_as_the_manual_writes_them() -> None:
    assert parse_reply(b"00S").prompt == "S"
    alarm = parse_reply(b"07A?T")
    assert (alarm.address, alarm.prompt, alarm.alarm, alarm.data) == (7, "", "T", "")
    assert parse_reply(b"00PI12.34W0.000ML").data == "I12.34W0.000ML"
    assert parse_reply(b"00S?OOR").data == "?OOR"
    assert parse_value("4500.ML") == (4500.0, "ML")


@pytest.mark.parametrize("noise", [b"", b"00", b"00Q", b"00A?Z", b"ok", b"\xff\xfe\xfd"])
def test_anything_else_is_not_a_reply(noise: bytes) -> None:
    with pytest.raises(DeviceProtocolError, match="not in the manual"):
        parse_reply(noise)
    with pytest.raises(DeviceProtocolError):
        parse_value(".")
