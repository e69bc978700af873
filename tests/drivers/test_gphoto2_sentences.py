"""Every number that libgphoto2 may return, and the sentence that takes its place."""

import pytest
from faults_page import OperatorReads

from drivers import gphoto2_errors
from drivers.gphoto2_errors import device_error


@pytest.mark.parametrize("code", gphoto2_errors._SENTENCES, ids=str)
def test_a_number_of_libgphoto2_becomes_a_sentence(operator_reads: OperatorReads, code: int) -> None:
    operator_reads(device_error(code, doing="a photo", address="usb:001,005"))


def test_a_number_that_nobody_knows_still_carries_the_words_of_the_library(operator_reads: OperatorReads) -> None:
    operator_reads(device_error(-999, doing="a photo", address="usb:001,005", text="Fuse blown"))
