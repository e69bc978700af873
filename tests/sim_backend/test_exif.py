"""What emulated and simulated cameras write into their JPEG files, read back by Pillow."""

import io
from fractions import Fraction

import numpy as np
import pytest
import simplejpeg
from PIL import Image

from sim_backend.exif import Exposure, with_exif
from sim_backend.ptpip.body import Body
from sim_backend.ptpip.canon_eos import CanonEos40D
from sim_backend.ptpip.generic import GenericBody
from sim_backend.ptpip.world_photos import numbered

PICTURE = simplejpeg.encode_jpeg(np.full((16, 24, 1), 77, np.uint8), colorspace="GRAY")
EXPOSURE_TIME, F_NUMBER, SENSITIVITY, VERSION = 0x829A, 0x829D, 0x8827, 0x9000


def exif_of(data: bytes) -> dict[int, object]:
    with Image.open(io.BytesIO(data)) as picture:
        picture.load()
        return dict(picture.getexif().get_ifd(0x8769))


def test_another_program_reads_the_exposure() -> None:
    found = exif_of(with_exif(PICTURE, Exposure(Fraction(1, 15), Fraction(56, 10), 200)))
    assert found[EXPOSURE_TIME] == Fraction(1, 15)
    assert found[F_NUMBER] == Fraction(28, 5)
    assert found[SENSITIVITY] == 200
    assert found[VERSION] == b"0230"


def test_the_picture_and_its_number_stay_as_they_are() -> None:
    exposed = with_exif(numbered(PICTURE, 5), Exposure(Fraction(1, 4), Fraction(8), 100))
    assert b"photo 5" in exposed
    np.testing.assert_array_equal(
        simplejpeg.decode_jpeg(exposed, colorspace="GRAY"), simplejpeg.decode_jpeg(PICTURE, colorspace="GRAY")
    )


def test_what_is_no_jpeg_stays_as_it_is() -> None:
    assert with_exif(b"II*\0 a raw file", Exposure(Fraction(1, 4), Fraction(8), 100)) == b"II*\0 a raw file"


@pytest.mark.parametrize("body", [GenericBody, CanonEos40D])
def test_a_body_writes_its_settings_into_its_photos_and_a_turned_dial_as_well(body: type[Body]) -> None:
    camera = body(lambda: PICTURE, exposure_s=0.0, download_s=0.0)
    camera.faults.dial_turned = 1
    turned, right = (exif_of(camera.develop()) for _ in range(2))
    # Both begin with a quarter of a second, f/8 and ISO 100.
    assert (right[EXPOSURE_TIME], right[F_NUMBER], right[SENSITIVITY]) == (Fraction(1, 4), 8, 100)
    assert (turned[EXPOSURE_TIME], turned[F_NUMBER], turned[SENSITIVITY]) == (Fraction(1, 2), 8, 100)
