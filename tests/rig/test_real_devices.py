"""From a configuration to drivers: the ones that it names, and never a simulated one in their place."""

from pathlib import Path
from typing import Any

import pytest

from drivers.gphoto2_camera import Gphoto2Camera
from drivers.grbl_stage import GrblStage
from drivers.new_era_pump import NewEraPump
from drivers.stripe_player import StripePlayer
from drivers.tank_board import TankBoard
from drivers.zaber_stage import ZaberStage
from rig.capturing.operators import ConsoleOperator
from rig.config import DeviceAddresses, PumpDriver, RigConfig
from rig.devices import Devices, open_real_devices, real_devices, real_display
from rig.errors import ConfigError
from rig.tank.ledger_book import book_of
from sim_backend.clock import RealClock

LAB = {
    "camera": "gphoto2:usb:",
    "display": "browser:127.0.0.1:0",
    "stage": "grbl:/dev/ttyUSB0",
    "pump": "new_era:/dev/ttyUSB1",
}
NEW_ERA = PumpDriver(diameter_mm=26.59)


@pytest.fixture(autouse=True)
def _state_is_kept_elsewhere(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))


def lab(config: RigConfig, addresses: dict[str, str], **parts: Any) -> RigConfig:
    return config.model_copy(update={"pump": NEW_ERA, "devices": DeviceAddresses(**(LAB | addresses)), **parts})


def composed(config: RigConfig, tmp_path: Path) -> Devices:
    display = real_display(config, keep=tmp_path)
    return real_devices(
        config, display=display, operator=ConsoleOperator(), clock=RealClock(), book=book_of(config, None), kind="real"
    )


def test_every_device_is_the_driver_that_its_address_names(config: RigConfig, tmp_path: Path) -> None:
    devices = composed(lab(config, {}), tmp_path)
    assert isinstance(devices.camera, Gphoto2Camera)
    assert isinstance(devices.display, StripePlayer)
    assert isinstance(devices.stage, GrblStage)
    assert isinstance(devices.pump, NewEraPump)
    assert devices.level_sensor is None
    assert devices.stage.info().kind == devices.pump.info().kind == devices.display.info().kind == "real"


def test_a_calibrated_tank_board_is_pump_and_level_sensor_in_one(config: RigConfig, tmp_path: Path) -> None:
    board = {"pump": "tank_board:/dev/ttyACM0"}
    calibrated = PumpDriver(level_points=((100.0, 0.0), (900.0, 4000.0)))
    devices = composed(lab(config, board, pump=calibrated), tmp_path)
    assert isinstance(devices.pump, TankBoard)
    assert devices.level_sensor is devices.pump
    assert composed(lab(config, board, pump=PumpDriver()), tmp_path).level_sensor is None


def test_a_zaber_stage_counts_in_the_configured_microstep(config: RigConfig, tmp_path: Path) -> None:
    zaber = {"stage": "zaber:/dev/ttyUSB0"}
    with pytest.raises(ConfigError, match="microstep_mm: this value is missing"):
        composed(lab(config, zaber), tmp_path)
    stage = config.stage.model_copy(update={"microstep_mm": 0.000047625})
    assert isinstance(composed(lab(config, zaber, stage=stage), tmp_path).stage, ZaberStage)


def test_a_rig_without_a_tank_gets_no_pump_even_if_one_is_named(thin_config: RigConfig, tmp_path: Path) -> None:
    assert composed(lab(thin_config, {}), tmp_path).pump is None


@pytest.mark.parametrize("missing", ["camera", "display", "stage", "pump"])
def test_a_device_that_is_not_configured_is_refused_before_any_is_opened(config: RigConfig, missing: str) -> None:
    with pytest.raises(ConfigError, match=f"no {missing} configured"), open_real_devices(lab(config, {missing: ""})):
        pass


@pytest.mark.parametrize("device", ["camera", "display", "stage", "pump"])
def test_an_address_of_no_driver_is_refused_before_any_is_opened(config: RigConfig, device: str) -> None:
    with (
        pytest.raises(ConfigError, match=f"devices.{device}: no driver answers to 'magic:"),
        open_real_devices(lab(config, {device: "magic:/dev/ttyUSB9"})),
    ):
        pass
