"""The emulated cameras on the wire, asked by a host that shares no code with them."""

import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from ptpip_host import Host, receive

from sim_backend.ptpip.body import Body
from sim_backend.ptpip.canon_eos import CanonEos40D
from sim_backend.ptpip.generic import GenericBody
from sim_backend.ptpip.responder import Responder

PHOTO = b"\xff\xd8 a photo \xff\xd9"
OPEN_SESSION, GET_HANDLES, GET_INFO, GET_OBJECT, DELETE, CAPTURE = 0x1002, 0x1007, 0x1008, 0x1009, 0x100B, 0x100E
GET_DESCRIPTION, GET_VALUE, SET_VALUE = 0x1014, 0x1015, 0x1016
REMOTE_RELEASE, SET_EOS_VALUE, SET_EVENT_MODE, GET_EVENT, TRANSFER_COMPLETE = 0x910F, 0x9110, 0x9115, 0x9116, 0x9117
OK, BUSY, FULL, NOT_OPEN, UNSUPPORTED, NO_OBJECT = 0x2001, 0x2019, 0x200C, 0x2003, 0x2005, 0x2009
SHUTTER, ISO = 0x500D, 0x500F


@contextmanager
def serving(body: Body) -> Iterator[Responder]:
    responder = Responder(body)
    threading.Thread(target=responder.serve, daemon=True).start()
    try:
        yield responder
    finally:
        responder.close()


@contextmanager
def session(body: Body) -> Iterator[Host]:
    with serving(body) as responder, Host(responder.port) as host:
        host.say_hello()
        assert host.ask(OPEN_SESSION, 1)[0] == OK
        yield host


def generic() -> GenericBody:
    return GenericBody(lambda: PHOTO, exposure_s=0.0, download_s=0.0)


def eos() -> CanonEos40D:
    return CanonEos40D(lambda: PHOTO, exposure_s=0.0, download_s=0.0)


def photo_handles(host: Host) -> list[int]:
    """The handles of all JPEG files (format 0x3801) on every store."""
    code, data = host.ask(GET_HANDLES, 0xFFFFFFFF, 0x3801, 0)
    assert code == OK
    count, *handles = struct.unpack(f"<{len(data) // 4}I", data)
    assert count == len(handles)
    return handles


def records(host: Host) -> list[tuple[int, bytes]]:
    """What a Canon body has to say: records ``u32 size, u32 code, body``, ended by one of size 8 and code 0."""
    code, data = host.ask(GET_EVENT)
    assert code == OK
    found = []
    while data:
        size, kind = struct.unpack_from("<II", data)
        found.append((kind, data[8:size]))
        data = data[size:]
    assert found.pop() == (0, b"")
    return found


@pytest.mark.parametrize(("body", "name"), [(generic(), "Emulated PTP camera"), (eos(), "Canon EOS 40D")])
def test_a_camera_says_who_it_is(body: Body, name: str) -> None:
    with serving(body) as responder, Host(responder.port) as host:
        assert host.say_hello() == name
        code, info = host.ask(0x1001)
        assert code == OK
        assert name.encode("utf-16-le") in info


def test_nothing_but_a_greeting_works_without_a_session() -> None:
    with serving(generic()) as responder, Host(responder.port) as host:
        host.say_hello()
        assert host.ask(CAPTURE)[0] == NOT_OPEN
        assert host.ask(OPEN_SESSION, 1)[0] == OK
        assert host.ask(CAPTURE)[0] == OK


def test_an_operation_that_the_camera_does_not_have_is_refused() -> None:
    with session(generic()) as host:
        assert host.ask(REMOTE_RELEASE)[0] == UNSUPPORTED
    with session(eos()) as host:
        assert host.ask(CAPTURE)[0] == UNSUPPORTED


def test_a_capture_adds_an_object_that_can_be_fetched_and_deleted() -> None:
    with session(generic()) as host:
        assert host.ask(CAPTURE)[0] == OK
        code, (handle,) = host.next_event()
        assert code == 0x4002  # ObjectAdded
        assert host.next_event() == (0x400D, ())  # CaptureComplete
        assert photo_handles(host) == [handle]
        _code, info = host.ask(GET_INFO, handle)
        assert struct.unpack_from("<HHI", info, 4) == (0x3801, 0, len(PHOTO))
        assert host.ask(GET_OBJECT, handle) == (OK, PHOTO)
        assert host.ask(DELETE, handle)[0] == OK
        assert host.ask(GET_OBJECT, handle)[0] == NO_OBJECT
        assert photo_handles(host) == []


def test_a_value_is_set_when_it_is_one_of_the_choices() -> None:
    with session(generic()) as host:
        assert host.ask(SET_VALUE, SHUTTER, data=struct.pack("<I", 625)) == (OK, b"")
        assert host.ask(GET_VALUE, SHUTTER) == (OK, struct.pack("<I", 625))
        assert host.ask(SET_VALUE, SHUTTER, data=struct.pack("<I", 626))[0] == 0x201C  # invalid value
        assert host.ask(SET_VALUE, SHUTTER, data=b"")[0] == 0x201C
        assert host.ask(GET_VALUE, SHUTTER) == (OK, struct.pack("<I", 625))
        assert host.ask(SET_VALUE, 0xDEAD, data=bytes(4))[0] == 0x200A  # no such property


def test_a_description_holds_type_value_and_choices() -> None:
    with session(generic()) as host:
        code, data = host.ask(GET_DESCRIPTION, ISO)
    # Property, u16, read and write, default, current, enumeration of three: ISO 15740, DevicePropDesc.
    assert (code, data) == (OK, struct.pack("<HHBHHBHHHH", ISO, 4, 1, 100, 100, 2, 3, 100, 200, 400))


@pytest.mark.parametrize("shutdown", [False, True])
def test_a_camera_can_be_left_and_joined_again(shutdown: bool) -> None:
    body = generic()
    with serving(body) as responder:
        for _ in range(3):
            with Host(responder.port) as host:
                host.say_hello()
                assert host.ask(OPEN_SESSION, 1)[0] == OK
                if shutdown:
                    assert host.ask(0x1003)[0] == OK


def test_a_connection_that_speaks_something_else_is_closed() -> None:
    with serving(generic()) as responder:
        with socket.create_connection(("127.0.0.1", responder.port), timeout=10.0) as stranger:
            stranger.sendall(b"GET / HTTP/1.1\r\n\r\n")
            with pytest.raises((EOFError, ConnectionError)):
                receive(stranger)
        with Host(responder.port) as host:
            host.say_hello()


# Faults


def test_a_busy_camera_refuses_so_many_captures() -> None:
    body = generic()
    body.faults.busy = 2
    with session(body) as host:
        assert [host.ask(CAPTURE)[0] for _ in range(3)] == [BUSY, BUSY, OK]


def test_a_full_card_refuses_every_capture() -> None:
    body = generic()
    body.faults.card_full = True
    with session(body) as host:
        assert [host.ask(CAPTURE)[0] for _ in range(2)] == [FULL, FULL]
        body.faults.card_full = False
        assert host.ask(CAPTURE)[0] == OK


def test_a_truncated_download_ends_half_way_and_the_next_is_whole() -> None:
    body = generic()
    body.faults.truncated = 1
    with session(body) as host:
        host.ask(CAPTURE)
        _code, (handle,) = host.next_event()
        assert host.ask(GET_OBJECT, handle) == (OK, PHOTO[: len(PHOTO) // 2])
        assert host.ask(GET_OBJECT, handle) == (OK, PHOTO)


def test_a_dropped_link_closes_both_connections_without_an_answer() -> None:
    body = generic()
    body.faults.dropped_link = 1
    with session(body) as host:
        with pytest.raises((EOFError, ConnectionError)):
            host.ask(CAPTURE)
        with pytest.raises((EOFError, ConnectionError)):
            host.next_event()


def test_a_silent_camera_reads_and_does_not_answer() -> None:
    body = generic()
    with session(body) as host:
        body.faults.silent = True
        host.commands.settimeout(0.2)
        with pytest.raises(TimeoutError):
            host.ask(CAPTURE)
    assert body.photos_taken == 0


def test_a_photo_taken_by_hand_is_announced_unasked() -> None:
    body = generic()
    with session(body) as host:
        body.press_shutter_by_hand()
        code, (handle,) = host.next_event()
        assert code == 0x4002
        assert host.ask(GET_OBJECT, handle) == (OK, PHOTO)


def test_a_fault_that_does_not_exist_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match="no fault 'gremlins'; there are busy, stale"):
        generic().faults.update({"gremlins": 1})


# Canon


def test_an_eos_reports_its_settings_when_events_are_switched_on() -> None:
    with session(eos()) as host:
        assert records(host) == []
        assert host.ask(SET_EVENT_MODE, 1)[0] == OK
        found = records(host)
    values = dict(struct.unpack_from("<II", body) for code, body in found if code == 0xC189)
    assert values[0xD102] == 0x48  # 1/4 s
    assert values[0xD108] == 3  # manual focus
    assert values[0xD11C] == 2  # photos go to the card
    assert {0xD102, 0xD103} <= {struct.unpack_from("<I", body)[0] for code, body in found if code == 0xC18A}


def test_an_eos_reports_a_setting_that_was_changed() -> None:
    with session(eos()) as host:
        assert host.ask(SET_EOS_VALUE, data=struct.pack("<III", 12, 0xD102, 0x50))[0] == OK
        assert records(host) == [(0xC189, struct.pack("<II", 0xD102, 0x50))]
        assert host.ask(SET_EOS_VALUE, data=struct.pack("<III", 12, 0xD102, 0x51))[0] == 0x201C
        assert records(host) == []


def test_an_eos_offers_a_photo_to_the_host_and_forgets_it_afterwards() -> None:
    with session(eos()) as host:
        host.ask(SET_EOS_VALUE, data=struct.pack("<III", 12, 0xD11C, 4))  # photos go to the host
        records(host)
        assert host.ask(REMOTE_RELEASE)[0] == OK
        offers = [body for code, body in records(host) if code == 0xC186]
        assert len(offers) == 1
        handle, kind, _, size = struct.unpack_from("<4I", offers[0])
        assert (kind, size) == (0x3801, len(PHOTO))
        assert offers[0][20:].rstrip(b"\0") == b"IMG_00001.JPG"
        assert host.ask(0x101B, handle, 0, 5) == (OK, PHOTO[:5])
        assert host.ask(0x101B, handle, 5, 1000) == (OK, PHOTO[5:])
        assert host.ask(TRANSFER_COMPLETE, handle)[0] == OK
        assert host.ask(0x101B, handle, 0, 5)[0] == NO_OBJECT


def test_an_eos_puts_a_photo_on_the_card_when_asked_to() -> None:
    with session(eos()) as host:
        assert host.ask(REMOTE_RELEASE)[0] == OK
        added = [body for code, body in records(host) if code == 0xC181]
        assert len(added) == 1
        handle, _store, kind = struct.unpack_from("<3I", added[0])
        assert kind == 0x3801
        assert photo_handles(host) == [handle]
        assert host.ask(GET_OBJECT, handle) == (OK, PHOTO)
