"""Packets, datasets and photos of the emulated cameras, against bytes written out by hand."""

import socket
import struct

import pytest
import simplejpeg
from hypothesis import given
from hypothesis import strategies as st

from sim_backend.ptpip import packets
from sim_backend.ptpip.datasets import array_u16, array_u32, ptp_string
from sim_backend.ptpip.packets import LinkClosedError, PacketType
from sim_backend.ptpip.sources import drawn_photos, photos_of_folder
from sim_backend.ptpip.world_photos import numbered


def test_strings_and_arrays_are_laid_out_as_the_standard_says() -> None:
    assert ptp_string("") == b"\0"
    assert ptp_string("EOS") == b"\x04E\0O\0S\0\0\0"
    assert array_u16([0x1001, 0x1002]) == b"\x02\0\0\0\x01\x10\x02\x10"
    assert array_u32([]) == b"\0\0\0\0"


def test_a_response_is_length_type_code_transaction_and_parameters() -> None:
    assert packets.response(0x2001, 7) == bytes.fromhex("0e000000 07000000 0120 07000000")
    assert packets.response(0x2001, 7, (1,)) == bytes.fromhex("12000000 07000000 0120 07000000 01000000")
    assert packets.event(0x4002, 0, (5,)) == bytes.fromhex("12000000 08000000 0240 00000000 05000000")


@given(data=st.binary(max_size=5000), block=st.integers(1, 2000))
def test_a_data_phase_carries_every_byte_in_order(data: bytes, block: int) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(packets, "DATA_BLOCK", block)
        parts = list(packets.data_phase(3, data))
    kinds = [struct.unpack_from("<I", part, 4)[0] for part in parts]
    assert kinds[0] == PacketType.START_DATA
    assert kinds[-1] == PacketType.END_DATA
    assert set(kinds[1:-1]) <= {PacketType.DATA}
    assert struct.unpack_from("<IQ", parts[0], 8) == (3, len(data))
    assert b"".join(part[12:] for part in parts[1:]) == data
    assert all(struct.unpack_from("<I", part)[0] == len(part) for part in parts)


def test_a_packet_that_arrives_in_pieces_is_put_together_and_a_cut_one_is_an_error() -> None:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        whole = packets.packet(PacketType.PING, b"abc")
        theirs.sendall(whole[:3])
        theirs.sendall(whole[3:] + whole[:9])
        assert packets.read_packet(ours) == (PacketType.PING, b"abc")
        theirs.shutdown(socket.SHUT_WR)
        with pytest.raises(LinkClosedError):
            packets.read_packet(ours)


@pytest.mark.parametrize("length", [0, 7, 2**31])
def test_a_length_that_cannot_be_is_an_error(length: int) -> None:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        theirs.sendall(struct.pack("<II", length, 6))
        with pytest.raises(LinkClosedError, match="bytes"):
            packets.read_packet(ours)


def test_a_number_makes_two_files_of_one_picture_differ_and_shows_the_same() -> None:
    picture = drawn_photos()()
    first, second = numbered(picture, 1), numbered(picture, 2)
    assert first != second
    decoded = [simplejpeg.decode_jpeg(data, colorspace="GRAY").tobytes() for data in (picture, first, second)]
    assert decoded[0] == decoded[1] == decoded[2]


def test_a_folder_is_photographed_in_the_order_of_its_names(tmp_path) -> None:
    for name in ("b.jpg", "a.JPG", "notes.txt"):
        (tmp_path / name).write_bytes(name.encode())
    photograph = photos_of_folder(tmp_path)
    assert [photograph() for _ in range(3)] == [b"a.JPG", b"b.jpg", b"a.JPG"]
