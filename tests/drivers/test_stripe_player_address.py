"""What the address of the display's page is made of: token, certificate, host and port, and the code that a tablet reads."""

import stat
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from faults_page import OperatorReads

from drivers.errors import DeviceNotFoundError, DeviceProtocolError
from drivers.stripe_player.address import PageAddress, keep_token, parse_address, qr_code
from drivers.stripe_player.certificate import server_context


def test_the_token_is_kept_and_readable_by_its_owner_only(tmp_path: Path) -> None:
    token = keep_token(tmp_path / "state")
    assert keep_token(tmp_path / "state") == token
    assert len(token) >= 16
    assert keep_token(tmp_path / "other") != token
    assert stat.S_IMODE((tmp_path / "state" / "token").stat().st_mode) == 0o600
    (tmp_path / "state" / "token").write_text("short")
    assert len(keep_token(tmp_path / "state")) >= 16


def test_the_certificate_is_kept_for_the_same_address_and_its_key_is_secret(
    tmp_path: Path, require_program: Callable[[str, str], str]
) -> None:
    require_program("openssl", "openssl")
    server_context(tmp_path, "192.168.7.8")
    first = (tmp_path / "certificate.pem").read_text()
    server_context(tmp_path, "192.168.7.8")
    assert (tmp_path / "certificate.pem").read_text() == first
    assert stat.S_IMODE((tmp_path / "key.pem").stat().st_mode) == 0o600
    server_context(tmp_path, "192.168.7.9")
    assert (tmp_path / "certificate.pem").read_text() != first


def test_a_machine_without_openssl_says_what_to_install(
    operator_reads: OperatorReads, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with operator_reads.raised(DeviceNotFoundError):
        server_context(tmp_path, "192.168.7.8")


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("192.168.1.5:9000", PageAddress("192.168.1.5", 9000, True)),
        ("http://192.168.1.5", PageAddress("192.168.1.5", 8443, False)),
        ("localhost:80", PageAddress("127.0.0.1", 80, False)),
        ("https://127.0.0.1:1/", PageAddress("127.0.0.1", 1, True)),
        ("[fd00::5]:70", PageAddress("fd00::5", 70, True)),
    ],
)
def test_an_address_is_read(text: str, address: PageAddress) -> None:
    assert parse_address(text) == address


@pytest.mark.parametrize("text", ["tablet.local", "1.2.3.4:99999", "1.2.3:4:5", "ftp://1.2.3.4", "999.1.1.1"])
def test_an_address_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(DeviceProtocolError, match="display: "):
        parse_address(text)


def test_the_qr_code_reads_back_as_the_address() -> None:
    url = PageAddress("192.168.1.5", 8443, True).url("Fk3-x9_QbTz71LmA")
    lines = qr_code(url).splitlines()
    # Compact drawing: each letter is two modules, one above the other; escape codes choose which of them is light.
    modules = modules_of(lines)
    # OpenCV's reader misses some sharp drawings at one size and not at another, as no telephone does.
    read = {
        cv2.QRCodeDetector().detectAndDecode(np.kron(modules, np.full((size, size), 255, np.uint8)))[0]
        for size in (4, 6, 8, 10, 12)
    }
    assert url in read


def modules_of(lines: list[str]) -> np.ndarray:
    """Return 1 for a light module, as a terminal with light letters on a dark ground shows it."""
    halves = {"█": (1, 1), "▀": (1, 0), "▄": (0, 1), " ": (0, 0)}
    rows: list[list[int]] = []
    for line in lines:
        letters, inverse = [], False
        k = 0
        while k < len(line):
            if line[k] == "\033":
                end = line.index("m", k)
                inverse = line[k : end + 1] == "\033[7m"
                k = end + 1
                continue
            top, bottom = halves[line[k]]
            letters.append((1 - top, 1 - bottom) if inverse else (top, bottom))
            k += 1
        rows += [[top for top, _ in letters], [bottom for _, bottom in letters]]
    width = max(len(row) for row in rows)
    return np.array([row + [0] * (width - len(row)) for row in rows], np.uint8)
