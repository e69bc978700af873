"""The frame tag: what was drawn is read back, and what cannot be read is never a wrong number."""

import cv2
import numpy as np
import pytest

from recon.patterns.frame_tag import (
    ACROSS_CELLS,
    LARGEST_NUMBER,
    POLYNOMIAL,
    TagPlace,
    bright_frame_cells,
    check_bits,
    data_cells,
    number_of,
    tag_cells,
    tag_levels,
)
from recon.patterns.frame_tag_reading import find_tag, read_tag

# Each photo pixel is the mean of this many samples squared.
FINE = 4


def photo_of(
    cells: np.ndarray,
    *,
    cell_px: float,
    centre_px: tuple[float, float] = (70.0, 70.0),
    side_px: int = 140,
    turn_rad: float = 0.0,
    tilt: float = 0.0,
    blur_cells: float = 0.0,
    gain: float = 150.0,
    offset: float = 12.0,
    noise: float = 0.0,
    rng: np.random.Generator | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Photograph a tag: each pixel collects light over its area, then come blur and noise. Returns photo and corners."""
    half = ACROSS_CELLS / 2 * cell_px
    turn = np.array([[np.cos(turn_rad), -np.sin(turn_rad)], [np.sin(turn_rad), np.cos(turn_rad)]])
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    corners[:2, 0] *= 1 - tilt  # the upper edge is further away
    corners_px = corners @ turn.T + centre_px
    source = np.kron(cells.astype(np.float32), np.ones((8, 8), np.float32))
    edge = 8 * ACROSS_CELLS
    of_source = np.array([[0, 0], [edge, 0], [edge, edge], [0, edge]], np.float32) - 0.5
    to_photo = cv2.getPerspectiveTransform(of_source, corners_px.astype(np.float32))
    to_fine = np.array([[FINE, 0, (FINE - 1) / 2], [0, FINE, (FINE - 1) / 2], [0, 0, 1]]) @ to_photo
    fine = cv2.warpPerspective(source, to_fine, (FINE * side_px, FINE * side_px), flags=cv2.INTER_LINEAR)
    light = cv2.resize(fine, (side_px, side_px), interpolation=cv2.INTER_AREA)
    if blur_cells:
        light = cv2.GaussianBlur(light, (0, 0), blur_cells * cell_px)
    counts = gain * light + offset
    if noise:
        assert rng is not None
        counts = counts + rng.normal(0, noise, counts.shape)
    return np.clip(np.round(counts), 0, 255).astype(np.uint8), corners_px


# What a tag is


def test_any_two_tags_differ_in_at_least_seven_of_their_thirty_two_pairs() -> None:
    # The check bits are linear, so the smallest distance is the smallest weight of a word that is not zero.
    numbers = np.arange(LARGEST_NUMBER + 1, dtype=np.uint32)
    words = np.zeros_like(numbers)
    for bit in range(16):
        word = 1 << (bit + 16) | check_bits(1 << bit)
        words ^= np.where(numbers >> bit & 1, np.uint32(word), np.uint32(0))
    for number in (1, 255, 12345, LARGEST_NUMBER):
        assert words[number] == number << 16 | check_bits(number)
    assert np.bitwise_count(words[1:]).min() == 7


@pytest.mark.parametrize("number", [1, 2, 999, 40000, LARGEST_NUMBER])
def test_number_and_check_bits_together_are_a_multiple_of_the_polynomial(number: int) -> None:
    word, divisor = (
        np.array([int(d) for d in f"{value:b}"], float) for value in (number << 16 | check_bits(number), POLYNOMIAL)
    )
    _, remainder = np.polydiv(word, divisor)
    assert not (np.round(remainder).astype(np.int64) % 2).any()


def test_every_tag_lights_the_same_number_of_cells() -> None:
    rng = np.random.default_rng(1)
    lit = {int(tag_cells(int(number)).sum()) for number in rng.integers(0, LARGEST_NUMBER + 1, 50)}
    assert lit == {36 - 2 + 32}


def test_no_rotation_or_mirror_image_of_the_frame_looks_the_same() -> None:
    frame = bright_frame_cells()
    turned = [np.rot90(side, k) for side in (frame, frame.T) for k in range(4)]
    assert sum(bool((other == frame).all()) for other in turned) == 1


def test_levels_are_the_cells_enlarged() -> None:
    levels = tag_levels(4711, cell_px=3)
    assert levels.shape == (36, 36)
    np.testing.assert_array_equal(levels[1::3, 1::3] == 255, tag_cells(4711))
    np.testing.assert_array_equal(levels, np.kron(levels[::3, ::3], np.ones((3, 3), np.uint8)))


@pytest.mark.parametrize("number", [-1, LARGEST_NUMBER + 1])
def test_a_number_that_does_not_fit_is_refused(number: int) -> None:
    with pytest.raises(ValueError, match=f"from 0 to 65535, not {number}"):
        tag_levels(number, cell_px=4)


def test_a_tag_covers_what_it_touches_and_nothing_else() -> None:
    place = TagPlace(column=100, row=50, cell_px=2)  # columns 100 to 123, rows 50 to 73
    assert place.covers(columns=(0.0, 100.0), rows=(60.0, 60.0))
    assert place.covers(columns=(123.0, 200.0), rows=(0.0, 50.0))
    assert not place.covers(columns=(0.0, 99.0), rows=(0.0, 1000.0))
    assert not place.covers(columns=(124.0, 200.0), rows=(0.0, 1000.0))
    assert not place.covers(columns=(0.0, 1000.0), rows=(74.0, 80.0))


# Reading it back


@pytest.mark.parametrize("cell_px", [2.5, 3.3, 5.0, 9.7])
@pytest.mark.parametrize("seed", range(6))
def test_a_tag_is_read_from_about_its_place_through_blur_and_noise(cell_px: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    number = int(rng.integers(LARGEST_NUMBER + 1))
    photo, corners_px = photo_of(
        tag_cells(number), cell_px=cell_px, blur_cells=0.3, gain=rng.uniform(60, 230), noise=5.0, rng=rng
    )
    given_px = corners_px + rng.uniform(-0.9, 0.9, 2) * cell_px
    reading = read_tag(photo, given_px)
    assert (reading.number, reading.fault) == (number, "")
    # The place found is the true one, within a quarter of a cell.
    assert np.abs(reading.corners_px - corners_px).max() < 0.25 * cell_px + 0.25
    again = read_tag(photo, reading.corners_px)
    assert again.number == number


@pytest.mark.parametrize(("turn_rad", "tilt"), [(0.05, 0.0), (-0.05, 0.05), (0.6, 0.0), (2.0, 0.1)])
def test_a_tag_that_is_turned_or_tilted_is_read(turn_rad: float, tilt: float) -> None:
    photo, corners_px = photo_of(tag_cells(31000), cell_px=5, turn_rad=turn_rad, tilt=tilt, blur_cells=0.25)
    assert read_tag(photo, corners_px).number == 31000


@pytest.mark.parametrize("factor", [0.93, 1.07])
def test_a_place_that_is_a_little_too_small_or_large_is_near_enough(factor: float) -> None:
    photo, corners_px = photo_of(tag_cells(1234), cell_px=6, blur_cells=0.2)
    middle = corners_px.mean(axis=0)
    assert read_tag(photo, middle + (corners_px - middle) * factor).number == 1234


def test_sixteen_bit_photos_are_read_in_their_own_counts() -> None:
    photo, corners_px = photo_of(tag_cells(77), cell_px=5, blur_cells=0.2)
    assert read_tag(photo.astype(np.uint16) * 257, corners_px, full_scale=65535.0).number == 77


@pytest.mark.parametrize("turn_rad", [0.0, 0.7, np.pi / 2, 3.0, -1.2])
def test_a_tag_is_found_without_knowing_its_place_or_direction(turn_rad: float) -> None:
    photo, corners_px = photo_of(
        tag_cells(50123), cell_px=5, centre_px=(90, 78), side_px=180, turn_rad=turn_rad, blur_cells=0.25
    )
    reading = find_tag(photo)
    assert reading is not None
    assert reading.number == 50123
    assert np.abs(reading.corners_px - corners_px).max() < 0.25 * 5


def test_no_tag_is_found_where_there_is_none() -> None:
    rng = np.random.default_rng(3)
    assert find_tag(np.zeros((60, 60), np.uint8)) is None
    assert find_tag(rng.integers(0, 256, (120, 120), dtype=np.uint8)) is None
    box = np.zeros((120, 120), np.uint8)
    cv2.rectangle(box, (20, 20), (90, 90), 255, 6)
    assert find_tag(box) is None


# Saying that it cannot be read


def test_what_cannot_be_read_says_why() -> None:
    photo, corners_px = photo_of(tag_cells(9), cell_px=5)
    assert read_tag(photo, corners_px + 60).fault == "outside the photo"
    assert read_tag(photo, corners_px.mean(axis=0) + (corners_px - corners_px.mean(axis=0)) / 4).fault == "too small"
    assert read_tag(photo // 60, corners_px).fault == "too dark"
    assert read_tag(np.zeros_like(photo), corners_px).fault == "too dark"
    bright = np.random.default_rng(0).integers(0, 256, photo.shape, dtype=np.uint8)
    assert read_tag(bright, corners_px).fault in ("no tag here", "too dark")
    assert read_tag(np.ascontiguousarray(np.rot90(photo)), corners_px).number is None
    assert read_tag(np.ascontiguousarray(photo[:, ::-1]), corners_px).number is None


@pytest.mark.parametrize("number", [0, 1500, 2999])
def test_a_photo_of_two_frames_in_turn_is_no_photo_of_either(number: int) -> None:
    first, corners_px = photo_of(tag_cells(number), cell_px=5, blur_cells=0.25)
    second, _ = photo_of(tag_cells(number + 1), cell_px=5, blur_cells=0.25)
    for share in np.linspace(0, 1, 21):
        mixed = np.round((1 - share) * first.astype(float) + share * second).astype(np.uint8)
        read = read_tag(mixed, corners_px).number
        if 0.35 <= share <= 0.65:
            assert read is None
        else:
            assert read in ({number, None} if share < 0.5 else {number + 1, None})
        if share in (0, 1):
            assert read is not None


@pytest.mark.parametrize("seed", range(4))
def test_sixty_bad_photos_give_no_wrong_number(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    read = 0
    for _ in range(60):
        number = int(rng.integers(LARGEST_NUMBER + 1))
        cell_px = rng.uniform(2, 5)
        photo, corners_px = photo_of(
            tag_cells(number),
            cell_px=cell_px,
            centre_px=(40.0, 40.0),
            side_px=80,
            turn_rad=rng.uniform(-0.08, 0.08),
            blur_cells=rng.uniform(0.1, 0.8),
            gain=rng.uniform(5, 200),
            noise=rng.uniform(1, 40),
            rng=rng,
        )
        if rng.random() < 0.3:  # a drop, or a glare
            x, y = rng.uniform(10, 70, 2).astype(int)
            cv2.circle(photo, (int(x), int(y)), int(rng.uniform(3, 15)), int(rng.choice([0, 255])), -1)
        found = read_tag(photo, corners_px + rng.uniform(-1, 1, 2) * cell_px).number
        assert found in (None, number)
        read += found is not None
    assert read > 5  # the photos are bad, not black


def test_random_pairs_behind_a_good_ring_pass_the_check_as_seldom_as_sixteen_bits_allow() -> None:
    rng = np.random.default_rng(8)
    passed = sum(number_of(rng.random(32) < 0.5) is not None for _ in range(16_384))
    # One in 65,536 words is a tag: a quarter of one expected, and more than 4 would happen six times in a million
    assert passed <= 4


def test_a_single_wrong_pair_is_always_noticed() -> None:
    for number in (0, 1, 2718, LARGEST_NUMBER):
        cells = tag_cells(number)[data_cells()].reshape(8, 8)
        bits = (cells[:, 0::2] > cells[:, 1::2]).ravel()
        assert number_of(bits) == number
        for pair in range(32):
            wrong = bits.copy()
            wrong[pair] ^= True
            assert number_of(wrong) is None
