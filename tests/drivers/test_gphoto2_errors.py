"""Numbers of libgphoto2 become sentences that say what to do; files are whole or named as damaged."""

import pytest

from drivers.camera_profiles import PROFILES, profile_of, wrong_setting
from drivers.errors import (
    DeviceAlarmError,
    DeviceBusyError,
    DeviceError,
    DeviceNotFoundError,
    DeviceProtocolError,
    DeviceTimeoutError,
)
from drivers.gphoto2_errors import device_error
from drivers.photo_check import fault_of_file


@pytest.mark.parametrize(
    ("code", "kind", "advice"),
    [
        # Numbers and their meaning: gphoto2-port-result.h, gphoto2-result.h.
        (-1, DeviceProtocolError, "MF"),
        (-3, DeviceAlarmError, "empty card"),
        (-6, DeviceProtocolError, "remote control"),
        (-7, DeviceTimeoutError, "cable"),
        (-10, DeviceTimeoutError, "battery"),
        (-52, DeviceNotFoundError, "switch it on"),
        (-53, DeviceBusyError, "gio mount -s gphoto2"),
        (-60, DeviceBusyError, "close that program"),
        (-105, DeviceNotFoundError, "switch it on"),
        (-108, DeviceProtocolError, "take it again"),
        (-110, DeviceBusyError, "memory card"),
    ],
)
def test_a_number_becomes_a_sentence_with_advice(code: int, kind: type[DeviceError], advice: str) -> None:
    error = device_error(code, doing="a photo", address="usb:001,002")
    assert type(error) is kind
    assert str(error).startswith("camera usb:001,002: a photo asked, ")
    assert advice in str(error)
    assert f"(libgphoto2 {code})" in str(error)


def test_an_unknown_number_still_carries_the_words_of_the_library() -> None:
    assert "'Fuse blown'" in str(device_error(-999, doing="a photo", address="usb:", text="Fuse blown"))


def test_what_the_bus_knows_replaces_the_guess() -> None:
    text = str(device_error(-53, doing="to open it", address="usb:", reason="gvfsd-gphoto2 (42) holds it; close it"))
    assert "gvfsd-gphoto2 (42) holds it; close it" in text
    assert "another program" not in text


WHOLE_JPEG = b"\xff\xd8\xff\xe0 picture \xff\xd9"


@pytest.mark.parametrize(
    ("data", "suffix", "announced_bytes", "fault"),
    [
        (WHOLE_JPEG, ".jpg", None, None),
        (WHOLE_JPEG, ".JPG", len(WHOLE_JPEG), None),
        (WHOLE_JPEG + b"\0\0\0", ".jpg", len(WHOLE_JPEG) + 3, None),  # padded by the body
        (WHOLE_JPEG[:-2], ".jpg", None, "ends before"),
        (WHOLE_JPEG[:-1], ".jpg", None, "ends before"),
        (WHOLE_JPEG[1:], ".jpeg", None, "does not begin"),
        (WHOLE_JPEG, ".jpg", 1000, "announced 1000"),
        (b"", ".jpg", None, "empty"),
        (b"II*\0 raw", ".CR2", None, None),
        (b"MM\0* raw", ".nef", None, None),
        (b"\0\0\0\0 raw", ".cr2", None, "does not begin"),
        (b"anything", ".x3f", None, None),
    ],
)
def test_a_file_is_judged_by_its_own_bytes(
    data: bytes, suffix: str, announced_bytes: int | None, fault: str | None
) -> None:
    found = fault_of_file(data, suffix=suffix, announced_bytes=announced_bytes)
    assert found is None if fault is None else fault in str(found)


@pytest.mark.parametrize(
    ("model", "profile"),
    [
        ("Canon EOS 40D", "canon-eos-40d"),
        ("Canon EOS 1000D", "canon-eos-40d"),
        ("Canon EOS 5D Mark II", "canon-eos-40d"),
        ("Canon EOS 5D Mark III", "canon-eos"),
        ("Canon EOS 740D", "canon-eos"),
        ("Canon EOS R5", "canon-eos"),
        ("Nikon DSC D750", "nikon"),
        ("PTP/IP Camera", "generic"),
        ("DMC-GH5", "generic"),
    ],
)
def test_a_profile_is_found_by_the_model(model: str, profile: str) -> None:
    assert profile_of(model).name == profile


@pytest.mark.parametrize("profile", PROFILES.values(), ids=PROFILES)
def test_every_required_setting_has_advice_and_is_watched(profile) -> None:
    assert set(profile.required) <= set(profile.watched)
    for name in profile.required:
        assert profile.advice.get(name, "set ") or name
    right = {name: values[0] for name, values in profile.required.items()}
    assert wrong_setting(profile, right) is None
    for name in profile.required:
        assert name in str(wrong_setting(profile, right | {name: "something else"}))
