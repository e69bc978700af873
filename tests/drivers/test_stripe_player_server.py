"""Who may talk to the display's page: one browser of the local network that has the token, and nobody else."""

import asyncio
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import aiohttp
import numpy as np
import pytest
from faults_page import OperatorReads

from drivers.errors import DeviceBusyError
from drivers.protocols import Frame
from drivers.stripe_player import StripePlayer
from drivers.stripe_player.address import is_local, parse_address

REPORT = {
    "columns": 64,
    "rows": 48,
    "ratio": 1,
    "zoom": 1,
    "visible": True,
    "fullscreen": True,
    "secure": True,
    "wake_lock": True,
    "refresh_hz": 60,
    "browser": "a test",
}
FRAME = Frame(axis="x", levels=np.zeros(64, np.uint8))


@pytest.fixture
def player(tmp_path: Path) -> Iterator[StripePlayer]:
    with StripePlayer(
        parse_address("127.0.0.1:0"),
        primary="white",
        state_folder=tmp_path,
        announce=print,
        page_timeout_s=10.0,
    ) as opened:
        yield opened


def origin(player: StripePlayer) -> str:
    return player.info().address


def get(url: str, **headers: str) -> tuple[int, str, Any]:
    async def ask() -> tuple[int, str, Any]:
        async with aiohttp.ClientSession() as session, session.get(url, headers=headers) as answer:
            return answer.status, await answer.text(), answer.headers

    return asyncio.run(ask())


def hello(page_id: str) -> str:
    return json.dumps({"type": "hello", "page_id": page_id, "report": REPORT})


def socket_url(player: StripePlayer) -> str:
    return player.url().replace("/?", "/socket?")


def test_the_page_with_its_token_is_given_and_may_load_nothing_from_elsewhere(player: StripePlayer) -> None:
    status, text, headers = get(player.url())
    assert status == 200
    assert "<canvas" in text
    assert "://" not in text.replace("'wss' : 'ws'}://", "")
    assert headers["Content-Security-Policy"].startswith("default-src 'none'; script-src 'sha256-")
    assert headers["Referrer-Policy"] == "no-referrer"
    assert headers["Cache-Control"] == "no-store"


@pytest.mark.parametrize("query", ["", "?token=", "?token=wrong", "?token=" + quote("é"), "?tok=x"])
def test_no_token_or_a_wrong_one_is_refused_with_a_sentence(
    operator_reads: OperatorReads, player: StripePlayer, query: str
) -> None:
    for path in ("/", "/socket"):
        status, text, _ = get(f"{origin(player)}{path}{query}", Origin=origin(player))
        assert status == 403
        operator_reads(text)


@pytest.mark.parametrize(
    "path",
    ["/../../etc/passwd", "/..%2f..%2fetc%2fpasswd", "/page.html", "/server.py", "/%2e%2e/player.py", "//etc/passwd"],
)
def test_no_path_leads_outside(player: StripePlayer, path: str) -> None:
    async def ask_raw() -> bytes:
        netloc = origin(player).removeprefix("http://")
        host, port = netloc.split(":")
        reader, writer = await asyncio.open_connection(host, int(port))
        query = player.url().split("?")[1]
        writer.write(f"GET {path}?{query} HTTP/1.1\r\nHost: {netloc}\r\nConnection: close\r\n\r\n".encode())
        answer = await asyncio.wait_for(reader.read(), 10)
        writer.close()
        await writer.wait_closed()
        return answer

    assert asyncio.run(ask_raw()).startswith((b"HTTP/1.1 404", b"HTTP/1.1 400"))


def test_a_foreign_origin_is_refused(operator_reads: OperatorReads, player: StripePlayer) -> None:
    for foreign in ("http://example.net", "null", origin(player) + "0", ""):
        status, text, _ = get(socket_url(player), **({"Origin": foreign} if foreign else {}))
        assert status == 403
        operator_reads(text)


def test_a_name_that_was_pointed_at_this_machine_is_refused(
    operator_reads: OperatorReads, player: StripePlayer
) -> None:
    status, text, _ = get(player.url(), Host="rebound.example.net")
    assert status == 403
    operator_reads(text)


def test_a_caller_from_beyond_the_local_network_is_refused(
    operator_reads: OperatorReads, player: StripePlayer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.stripe_player.server.is_local", lambda peer: peer != "127.0.0.1")
    for url in (player.url(), socket_url(player)):
        status, text, _ = get(url, Origin=origin(player))
        assert status == 403
        operator_reads(text)


@pytest.mark.parametrize(
    ("peer", "local"),
    [
        ("127.0.0.1", True),
        ("::1", True),
        ("192.168.1.20", True),
        ("10.1.2.3", True),
        ("169.254.3.4", True),
        ("fe80::1%eth0", True),
        ("::ffff:192.168.1.20", True),
        ("8.8.8.8", False),
        ("::ffff:8.8.8.8", False),
        ("2606:4700::1111", False),
        ("", False),
        ("nonsense", False),
    ],
)
def test_only_private_addresses_are_local(peer: str, local: bool) -> None:
    assert is_local(peer) is local


async def next_json(socket: aiohttp.ClientWebSocketResponse) -> dict[str, Any]:
    return json.loads(await socket.receive_str(timeout=10))


async def close_code_of(socket: aiohttp.ClientWebSocketResponse) -> int | None:
    """Read on until the line is closed."""
    async with asyncio.timeout(10):
        while not (await socket.receive()).type.name.startswith("CLOS"):
            pass
    return socket.close_code


def test_a_message_that_is_too_large_closes_the_line(player: StripePlayer) -> None:
    async def talk() -> int | None:
        async with (
            aiohttp.ClientSession(headers={"Origin": origin(player)}) as session,
            session.ws_connect(socket_url(player)) as socket,
        ):
            await socket.send_str(hello("one"))
            assert (await next_json(socket))["type"] == "welcome"
            await socket.send_str("x" * 20_000)
            return await close_code_of(socket)

    assert asyncio.run(talk()) == aiohttp.WSCloseCode.MESSAGE_TOO_BIG
    deadline_s = time.monotonic() + 10
    while player.report() is not None and time.monotonic() < deadline_s:
        time.sleep(0.01)
    assert player.report() is None


@pytest.mark.parametrize(
    "words",
    [
        "no json",
        "[]",
        "{}",
        '{"type": "hello"}',
        '{"type": "dance", "report": {}}',
        json.dumps({"type": "report", "report": REPORT}),
        json.dumps({"type": "hello", "page_id": "x" * 65, "report": REPORT}),
        json.dumps({"type": "hello", "page_id": "x", "report": REPORT | {"columns": -1}}),
        json.dumps({"type": "hello", "page_id": "x", "report": REPORT | {"ratio": "two"}}),
        '{"type": "hello", "page_id": "x", "report": {"columns": NaN}}',
        "[" * 10_000,
    ],
)
def test_words_that_no_page_says_close_the_line(player: StripePlayer, words: str) -> None:
    async def talk() -> int | None:
        async with (
            aiohttp.ClientSession(headers={"Origin": origin(player)}) as session,
            session.ws_connect(socket_url(player)) as socket,
        ):
            await socket.send_str(words)
            await socket.receive(timeout=10)
            return socket.close_code

    assert asyncio.run(talk()) == aiohttp.WSCloseCode.POLICY_VIOLATION
    assert player.report() is None


def test_a_message_that_is_no_text_closes_the_line(player: StripePlayer) -> None:
    async def talk(*, introduced: bool) -> int | None:
        async with (
            aiohttp.ClientSession(headers={"Origin": origin(player)}) as session,
            session.ws_connect(socket_url(player)) as socket,
        ):
            if introduced:
                await socket.send_str(hello("one"))
                assert (await next_json(socket))["type"] == "welcome"
            await socket.send_bytes(hello("one").encode())
            return await close_code_of(socket)

    assert asyncio.run(talk(introduced=True)) == aiohttp.WSCloseCode.POLICY_VIOLATION
    assert asyncio.run(talk(introduced=False)) == aiohttp.WSCloseCode.POLICY_VIOLATION


def test_a_caller_that_does_not_introduce_itself_is_let_go_and_holds_nobody_up(
    player: StripePlayer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.stripe_player.server.HELLO_TIMEOUT_S", 0.3)

    async def talk() -> tuple[str, int | None]:
        async with (
            aiohttp.ClientSession(headers={"Origin": origin(player)}) as session,
            session.ws_connect(socket_url(player)) as silent,
            session.ws_connect(socket_url(player)) as page,
        ):
            await page.send_str(hello("one"))
            welcome = await next_json(page)
            await silent.receive(timeout=10)
            return welcome["type"], silent.close_code

    assert asyncio.run(talk()) == ("welcome", aiohttp.WSCloseCode.POLICY_VIOLATION)


def test_a_second_client_is_refused_with_a_sentence_and_the_first_stays(
    operator_reads: OperatorReads, player: StripePlayer
) -> None:
    async def talk() -> tuple[dict[str, Any], int | None, bool]:
        async with (
            aiohttp.ClientSession(headers={"Origin": origin(player)}) as session,
            session.ws_connect(socket_url(player)) as first,
            session.ws_connect(socket_url(player)) as second,
        ):
            await first.send_str(hello("one"))
            assert (await next_json(first))["type"] == "welcome"
            await second.send_str(hello("two"))
            refusal = await next_json(second)
            await second.receive(timeout=10)
            return refusal, second.close_code, player.report() is not None

    refusal, code, first_stays = asyncio.run(talk())
    assert refusal["type"] == "refused"
    operator_reads(refusal["reason"])
    assert code == 4003
    assert first_stays


def test_the_same_page_takes_its_own_place_when_its_old_line_is_not_known_dead(player: StripePlayer) -> None:
    async def talk() -> tuple[str, int | None]:
        async with (
            aiohttp.ClientSession(headers={"Origin": origin(player)}) as session,
            session.ws_connect(socket_url(player)) as old,
            session.ws_connect(socket_url(player)) as new,
        ):
            await old.send_str(hello("one"))
            assert (await next_json(old))["type"] == "welcome"
            await new.send_str(hello("one"))
            welcome = await next_json(new)
            while not (await old.receive(timeout=10)).type.name.startswith("CLOS"):
                pass
            assert player.report() is not None
            return welcome["type"], old.close_code

    assert asyncio.run(talk()) == ("welcome", 4001)


def header_of(message: bytes) -> dict[str, Any]:
    return json.loads(message[4 : 4 + int.from_bytes(message[:4], "little")])


@pytest.mark.parametrize(
    ("change", "counts"),
    [
        ({}, True),
        ({"seq": -1}, False),
        ({"seq": +1}, False),
        ({"run": "0123456789abcdef"}, False),
    ],
)
def test_only_the_acknowledgement_of_the_newest_frame_of_this_run_counts(
    player: StripePlayer, change: dict[str, Any], counts: bool
) -> None:
    async def talk() -> bool:
        async with (
            aiohttp.ClientSession(headers={"Origin": origin(player)}) as session,
            session.ws_connect(socket_url(player)) as socket,
        ):
            await socket.send_str(hello("one"))
            await next_json(socket)
            show = asyncio.create_task(asyncio.to_thread(player.show, FRAME, frame_id=5, timeout_s=1.0))
            header = header_of(await socket.receive_bytes(timeout=10))
            assert header["frame_id"] == 5
            said = {"type": "ack", "report": REPORT, "run": header["run"], "seq": header["seq"]}
            said |= {name: header["seq"] + by if name == "seq" else by for name, by in change.items()}
            await socket.send_str(json.dumps(said))
            return await asyncio.gather(show, return_exceptions=True) == [None]

    assert asyncio.run(talk()) is counts


def test_a_busy_port_is_said_in_a_sentence(operator_reads: OperatorReads, player: StripePlayer, tmp_path: Path) -> None:
    address = parse_address(origin(player))
    again = StripePlayer(
        address,
        primary="white",
        state_folder=tmp_path,
        announce=print,
        page_timeout_s=1.0,
    )
    with operator_reads.raised(DeviceBusyError):
        again.__enter__()
