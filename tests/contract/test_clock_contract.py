"""What every clock owes the rig."""

import pytest

from drivers.protocols import Clock
from sim_backend.clock import RealClock, SimulatedClock


@pytest.mark.parametrize("clock", [RealClock(), SimulatedClock()], ids=["real", "simulated"])
def test_sleeping_lets_that_much_time_pass_and_time_never_runs_backwards(clock: Clock) -> None:
    assert isinstance(clock, Clock)
    start_s = clock.now_s()
    clock.sleep_s(0.02)
    slept_s = clock.now_s() - start_s
    assert slept_s >= 0.02 - 1e-9
    clock.sleep_s(-1.0)
    clock.sleep_s(0.0)
    assert clock.now_s() >= start_s + slept_s
