"""The board's firmware, compiled for this computer: the header that the sketch includes, and not a copy of it."""

import subprocess
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_backend.tank_board_logic import Inputs, TankBoardLogic

ROOT = Path(__file__).parents[2]
HARNESS = Path(__file__).with_name("tank_logic_harness.cpp")
WRAP_MS = 2**32
# Time, leak contact open, over-fill contact open, level counts, line from the computer ("-" is none).
Step = tuple[int, bool, bool, int, str]
Run = Callable[[Iterable[Step]], list[str]]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, require_program: Callable[[str, str], str]) -> Run:
    program = tmp_path_factory.mktemp("firmware") / "tank_logic"
    compiler = require_program("g++", "g++")
    include = ROOT / "docs/firmware/tank_board"
    options = ["-std=c++11", "-Wall", "-Wextra", "-Werror"]
    subprocess.run([compiler, *options, f"-I{include}", str(HARNESS), "-o", str(program)], check=True)

    def run(steps: Iterable[Step]) -> list[str]:
        text = "".join(
            f"{t % WRAP_MS} {leak:d} {full:d} {level} {line or '(empty)'}\n" for t, leak, full, level, line in steps
        )
        ran = subprocess.run([program], input=text, capture_output=True, text=True, check=True)
        return ran.stdout.splitlines()

    return run


def script(*lines: tuple[int, str], start_ms: int = 0, step_ms: int = 10, end_ms: int | None = None) -> list[Step]:
    """Tick every ``step_ms`` with dry contacts, and say each line at its time."""
    said = dict(lines)
    last = max(said) if end_ms is None else end_ms
    times = sorted(set(range(0, last + 1, step_ms)) | set(said))
    return [(start_ms + t, False, False, 0, said.get(t, "-")) for t in times]


def pins(output: list[str]) -> str:
    """One letter a line: F filling, D draining, . off; the two pins together would be X."""
    return "".join({"0 0": ".", "1 0": "F", "0 1": "D"}.get(line[:3], "X") for line in output)


STARTS_MS = pytest.mark.parametrize("start_ms", [0, 12_345, WRAP_MS - 500], ids=["at once", "later", "millis wraps"])


@STARTS_MS
def test_the_pump_stops_when_no_heartbeat_came_for_a_second(run: Run, start_ms: int) -> None:
    output = run(script((0, "STOP"), (10, "FILL 60000"), (500, "HB"), start_ms=start_ms, end_ms=3000))
    # Line k is time 10 k: on from 10 ms to just before 1500 ms.
    assert pins(output) == "." + "F" * 149 + "." * 151


@STARTS_MS
def test_heartbeats_do_not_carry_a_run_past_its_own_time(run: Run, start_ms: int) -> None:
    beats = [(t, "HB") for t in range(200, 4000, 200)]
    output = run(script((0, "STOP"), (10, "DRAIN 2000"), *beats, start_ms=start_ms, end_ms=4000))
    assert pins(output) == "." + "D" * 200 + "." * 200


@STARTS_MS
def test_questions_are_no_heartbeats(run: Run, start_ms: int) -> None:
    questions = [(t, "STATE?") for t in range(100, 2000, 100)]
    output = run(script((0, "STOP"), (10, "FILL 60000"), *questions, start_ms=start_ms, end_ms=2000))
    assert pins(output).count("F") == 100
    assert "fault=heartbeat" in output[190]  # the last question


@pytest.mark.parametrize("time", ["0", "1800001", "999999999", "4294967297", "-5", "1e3", "", "5 5"])
def test_no_start_may_ask_for_more_than_the_cap_or_for_nothing(run: Run, time: str) -> None:
    output = run(script((0, "STOP"), (10, f"FILL {time}"), (20, "FILL"), end_ms=100))
    assert "NO" in output[1]
    assert "why=time" in output[2]
    assert pins(output) == "." * 11


def test_the_cap_itself_is_allowed_and_ends(run: Run) -> None:
    steps: list[Step] = [(0, False, False, 0, "STOP"), (0, False, False, 0, "FILL 1800000")]
    steps += [(t, False, False, 0, "HB") for t in range(500, 1_801_000, 500)]
    output = run(steps)
    assert pins(output)[1:].index(".") * 500 == 1_800_000


def test_a_leak_stops_everything_and_stays_on_record_until_it_is_dry_and_somebody_says_stop(run: Run) -> None:
    def wet(t: int, line: str) -> Step:
        return (t, True, False, 0, line)

    def dry(t: int, line: str) -> Step:
        return (t, False, False, 0, line)

    believed = [dry(0, "STOP"), dry(0, "FILL 60000"), wet(100, "HB"), wet(119, "HB"), wet(120, "-")]  # after 20 ms
    still_wet = [wet(130, "STOP"), wet(140, "DRAIN 1000")]
    wiped_up = [dry(150, "DRAIN 1000"), dry(160, "STOP"), dry(170, "DRAIN 1000")]
    output = run(believed + still_wet + wiped_up)
    assert pins(output) == ".FFF.....D"
    assert "fault=leak" in output[5]
    assert output[6].endswith("why=leak")
    assert output[7].endswith("why=fault")


def test_a_spark_is_no_leak(run: Run) -> None:
    steps: list[Step] = [(0, False, False, 0, "STOP"), (0, False, False, 0, "FILL 900")]
    steps += [(t, t % 30 < 19, False, 0, "-") for t in range(1, 800)]  # open for 19 ms, closed for 11
    assert "." not in pins(run(steps))[1:]


def test_a_full_tank_may_be_drained_but_not_filled(run: Run) -> None:
    def full(t: int, line: str) -> Step:
        return (t, False, True, 900, line)

    def below(t: int, line: str) -> Step:
        return (t, False, False, 900, line)

    filling = [below(0, "STOP"), below(0, "FILL 60000"), full(100, "-"), full(120, "HB")]
    output = run([*filling, full(130, "STOP"), full(140, "FILL 1000"), full(150, "DRAIN 1000"), full(200, "HB")])
    assert pins(output) == ".FF...DD"
    assert "fault=full" in output[3]
    assert output[5].endswith("full=1 level=900 why=full")


def test_a_leak_while_nothing_turns_is_on_record(run: Run) -> None:
    accident: list[Step] = [(0, False, False, 0, "STOP"), (100, True, False, 0, "-"), (130, True, False, 0, "-")]
    output = run([*accident, (140, False, False, 0, "LEAK?"), (150, False, False, 0, "FILL 10")])
    assert "fault=leak leak=0" in output[3]
    assert "why=fault" in output[4]


def test_a_board_that_woke_up_says_so_and_waits_for_a_stop(run: Run) -> None:
    output = run([(0, False, False, 0, "BOOT"), (10, False, False, 0, "FILL 1000")])
    assert output[0] == "0 0 OK BOOT IDLE ran=0 left=0 fault=reset leak=0 full=0 level=0"
    assert output[1].endswith("why=fault")


LINES = st.one_of(
    st.sampled_from(["-", "HB", "STOP", "STATE?", "LEVEL?", "LEAK?", "ID?", "FILL 300", "DRAIN 1500", "FILL 9999999"]),
    st.text(alphabet="FILDRANHBSTOP?0123456789 ", max_size=31)
    .map(str.strip)
    .filter(lambda text: text not in ("-", "BOOT")),
)
STEPS = st.lists(
    st.tuples(st.integers(0, 700), st.booleans(), st.booleans(), st.integers(0, 1023), LINES), min_size=1, max_size=40
)


@settings(max_examples=40, deadline=None)
@given(STEPS)
def test_the_emulated_board_says_what_the_firmware_says(run: Run, steps: list[Step]) -> None:
    logic = TankBoardLogic()
    now_ms, expected, timed = 0, [], []
    for pause_ms, leak, full, level, line in [(0, False, False, 0, "STOP"), *steps]:
        now_ms += pause_ms
        timed.append((now_ms, leak, full, level, line))
        logic.tick(now_ms, Inputs(leak, full, level))
        reply = "-" if line == "-" else logic.command(line, now_ms)
        expected.append(f"{int(logic.state == 'FILLING')} {int(logic.state == 'DRAINING')} {reply}")
    assert run(timed) == expected
