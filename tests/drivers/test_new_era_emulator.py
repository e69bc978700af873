"""The emulated New Era pump does what the manual says, byte by byte and without any driver."""

import binascii

import pytest
from pump_bench import dry_world

from sim_backend.clock import SimulatedClock
from sim_backend.new_era_emulator import NewEraEmulator
from sim_backend.new_era_memory import Memory, Phase
from sim_backend.world import World


@pytest.fixture
def world() -> World:
    return dry_world()


@pytest.fixture
def pump(world: World) -> NewEraEmulator:
    return NewEraEmulator(world)


def basic(pump: NewEraEmulator, command: str) -> str:
    reply = pump.receive(command.encode() + b"\r")
    assert reply[:1] == b"\x02"
    assert reply[-1:] == b"\x03"
    return reply[1:-1].decode()


def packed(command: str) -> bytes:
    data = command.encode()
    return b"\x02" + bytes([len(data) + 4]) + data + binascii.crc_hqx(data, 0).to_bytes(2, "big") + b"\x03"


def start_fill(pump: NewEraEmulator, volume: str) -> None:
    for command in ("DIRINF", "RAT60.0MM", f"VOL{volume}", "RUN"):
        assert "?" not in basic(pump, command)


def test_a_query_answers_in_the_form_of_its_setting(pump: NewEraEmulator) -> None:
    assert basic(pump, "dia 20.5") == "00S"
    assert basic(pump, "DIA") == "00S20.50"
    assert basic(pump, "0 RAT 123.4 MM") == "00S"
    assert basic(pump, "RAT") == "00S123.4MM"
    assert basic(pump, "VER").startswith("00SNE9000V")
    assert basic(pump, "XYZ") == "00S?"


def test_a_number_of_five_digits_is_out_of_range(pump: NewEraEmulator) -> None:
    assert basic(pump, "VOL123.45") == "00S?OOR"
    assert basic(pump, "VOL1.2345") == "00S?OOR"


def test_the_diameter_chooses_the_units_of_volume(pump: NewEraEmulator) -> None:
    basic(pump, "DIA14.00")
    assert basic(pump, "VOL").endswith("UL")
    basic(pump, "DIA14.01")
    assert basic(pump, "VOL").endswith("ML")


def test_a_volume_ends_the_run_and_zero_never_does(pump: NewEraEmulator, world: World) -> None:
    start_fill(pump, "50.0")
    world.clock.sleep_s(10.0)
    assert basic(pump, "DIS") == "00II10.00W0.000ML"
    world.clock.sleep_s(3600.0)
    assert basic(pump, "") == "00S"
    assert world.state().tank_ml == pytest.approx(50.0)
    start_fill(pump, "0")
    world.clock.sleep_s(1800.0)
    assert basic(pump, "") == "00I"
    assert world.state().tank_ml == pytest.approx(1850.0)


def test_the_first_stop_pauses_and_the_second_one_stops(pump: NewEraEmulator, world: World) -> None:
    start_fill(pump, "50.0")
    world.clock.sleep_s(10.0)
    assert basic(pump, "STP") == "00P"
    world.clock.sleep_s(10.0)
    assert basic(pump, "RUN") == "00I"
    world.clock.sleep_s(10.0)
    assert [basic(pump, "STP"), basic(pump, "STP")] == ["00P", "00S"]
    assert world.state().tank_ml == pytest.approx(20.0)


def test_a_program_goes_on_with_its_next_phase(world: World) -> None:
    left_behind = Memory(phases={1: Phase(rate=60.0, volume=50.0), 2: Phase(rate=60.0, volume=0.0)})
    pump = NewEraEmulator(world, memory=left_behind)
    basic(pump, "RUN")
    world.clock.sleep_s(50.0)
    basic(pump, "")
    world.clock.sleep_s(600.0)
    assert basic(pump, "") == "00I"
    assert world.state().tank_ml == pytest.approx(650.0)


def test_an_alarm_swallows_one_command(pump: NewEraEmulator) -> None:
    start_fill(pump, "50.0")
    pump.stall()
    assert basic(pump, "VOL99.0") == "00A?S"
    assert basic(pump, "VOL") == "00S50.00ML"


def test_safe_mode_has_a_dead_man_timer_that_announces_its_alarm(pump: NewEraEmulator, world: World) -> None:
    start_fill(pump, "500.0")
    assert pump.receive(packed("SAF5")) == packed("00I")
    world.clock.sleep_s(4.0)
    assert pump.receive(packed("")) == packed("00I")
    world.clock.sleep_s(60.0)
    assert pump.poll() == packed("00A?T")
    assert pump.poll() == b""
    assert world.state().tank_ml == pytest.approx(9.0)
    assert pump.receive(b"VOL\r") == b""  # a host in Basic mode hears nothing
    assert pump.receive(packed("")) == packed("00A?T")  # announcing it did not clear it
    # The packet of the manual's page 33; the reply comes in the mode that it asks for.
    assert pump.receive(bytes.fromhex("02 08 53 41 46 30 55 43 03")) == b"\x0200S\x03"


def test_a_host_is_silent_in_its_own_time_however_fast_the_world_runs(world: World) -> None:
    pump = NewEraEmulator(world, world_s_per_host_s=100.0)
    start_fill(pump, "900.0")
    assert pump.receive(packed("SAF5")) == packed("00I")
    world.clock.sleep_s(40.0)  # 0.4 s of the host, in which no packet counts as torn
    half = packed("VER")
    assert pump.receive(half[:4]) == b""
    world.clock.sleep_s(40.0)
    assert pump.receive(half[4:]) == packed("00INE9000V3.928")
    world.clock.sleep_s(499.0)
    assert pump.poll() == b""
    world.clock.sleep_s(600.0)
    assert pump.poll() == packed("00A?T")
    assert world.state().tank_ml == pytest.approx(580.0)  # 80 s, then 5 s of the host, at 1 ml/s


class SlowMachine(SimulatedClock):
    """Time goes on between any two steps of a program: here by a hundredth of a second."""

    def now_s(self) -> float:
        self.sleep_s(0.01)
        return super().now_s()


def test_a_packet_in_safe_mode_does_not_hold_up_the_head() -> None:
    world = dry_world(SlowMachine())
    pump = NewEraEmulator(world)
    start_fill(pump, "0")
    assert pump.receive(packed("SAF5")) == packed("00I")
    since_s, had_ml = world.clock.now_s(), world.state().tank_ml
    for _ in range(50):
        world.clock.sleep_s(1.0)
        assert pump.receive(packed("")) == packed("00I")
    # One millilitre a second; the two readings at either end are some hundredths of a second apart.
    elapsed_s = world.clock.now_s() - since_s
    assert world.state().tank_ml - had_ml == pytest.approx(elapsed_s, abs=0.1)


def test_safe_mode_survives_the_power_but_its_timer_waits_for_the_first_packet(
    pump: NewEraEmulator, world: World
) -> None:
    pump.receive(packed("SAF5"))
    pump.power_cycle()
    assert pump.poll() == packed("00A?R")
    world.clock.sleep_s(600.0)
    assert pump.poll() == b""
    assert pump.receive(packed("")) == packed("00A?R")
    world.clock.sleep_s(600.0)
    assert pump.poll() == packed("00A?T")


def test_a_broken_packet_is_answered_and_an_incomplete_one_forgotten(pump: NewEraEmulator, world: World) -> None:
    pump.receive(packed("SAF5"))
    broken = bytearray(packed("RUN"))
    broken[-2] ^= 1
    assert pump.receive(bytes(broken)) == packed("00S?COM")
    assert pump.receive(packed("VER")[:4]) == b""
    world.clock.sleep_s(0.6)
    assert pump.receive(packed("")) == packed("00S")


def test_power_that_comes_back_starts_the_pump_only_where_that_was_asked_for(pump: NewEraEmulator) -> None:
    for restarts, expected in (("0", "00S"), ("1", "00I")):
        basic(pump, f"PF{restarts}")
        start_fill(pump, "500.0")
        pump.power_cycle()
        assert basic(pump, "") == "00A?R"
        assert basic(pump, "") == expected


def test_another_pump_on_the_same_wire_is_not_meant(pump: NewEraEmulator) -> None:
    assert pump.receive(b"7VER\r") == b""
