"""The ``rig`` command as its user meets it: results on one line, errors in one sentence, never a traceback."""

import json
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import pytest

from recon.sessions.session import open_session
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene
from sim_backend.scene import scene_names

Run = Callable[..., tuple[int, str, str]]


def test_a_rehearsal_writes_a_whole_session(rig: Run, tiny_arguments, tmp_path: Path) -> None:
    code, out, err = rig("capture", "--sim", "--session", "s", *tiny_arguments)
    assert (code, err) == (0, "")
    assert out == "s: 72 photos, 72 of them taken now\n"
    assert len(open_session(tmp_path / "s").photos) == 72
    code, out, _ = rig("capture", "--sim", "--resume", "--session", "s")
    assert (code, out) == (
        0,
        "s: 72 of 72 photos are whole, 0 to be taken\ns: 72 photos, 0 of them taken now\n",
    )


def test_simulate_writes_session_and_truth(rig: Run, tiny_arguments, tmp_path: Path) -> None:
    code, out, err = rig("simulate", "hemisphere", "s", *tiny_arguments, "--seed", "5")
    assert (code, err) == (0, "")
    assert (tmp_path / "s/truth.npz").is_file()
    configuration = open_session(tmp_path / "s").manifest.provenance.configuration
    assert configuration["scene"]["seed"] == 5
    assert "photos and their truth" in out


def test_a_dry_run_prints_every_step_and_touches_nothing(rig: Run, tiny_arguments, tmp_path: Path) -> None:
    code, out, err = rig("capture", "--sim", "--dry-run", "--session", "s", *tiny_arguments)
    assert (code, err) == (0, "")
    lines = out.splitlines()
    assert lines[:2] == ["home the stage", "move the display to position 0 (10 mm)"]
    assert sum(line.startswith("photo ") for line in lines) == 72
    assert "fill 4000 ml into the tank" in lines
    assert list(tmp_path.iterdir()) == []


def test_a_dry_run_of_a_real_rig_opens_no_device(rig: Run, tmp_path: Path) -> None:
    assert rig("init")[0] == 0
    code, out, _ = rig("capture", "--dry-run", "--session", "s")
    assert code == 0
    assert out.startswith("home the stage\n")
    assert [path.name for path in tmp_path.iterdir()] == ["rig.toml"]


@pytest.mark.parametrize(
    ("arguments", "missing"),
    [
        (("capture", "--session", "s"), "camera, display, pump, stage"),
        (("pump", "fill", "100"), "pump"),
        (("stage", "home"), "stage"),
    ],
)
def test_nothing_falls_back_to_a_simulated_device(
    rig: Run, tmp_path: Path, arguments: tuple[str, ...], missing: str
) -> None:
    rig("init")
    code, out, err = rig(*arguments)
    assert (code, out) == (1, "")
    assert err.startswith(f"rig: no {missing} configured: name driver and address in the section [devices] of the ")
    assert err.endswith("or rehearse with --sim\n")
    assert err.count("\n") == 1
    assert not (tmp_path / "s").exists()


WRONG = [
    (("capture", "--session", "s"), "rig.toml: no such file; write one with `rig init rig.toml`"),
    (("capture", "--session", "s", "--scene", "hemisphere"), "add --sim"),
    (
        ("capture", "--session", "s", "--live"),
        "--live belongs to simulated devices; add --sim, or set it in the section [live]",
    ),
    (("calibrate", "check", "none.json"), "none.json: no such calibration"),
    (("calibrate", "caliper", "none.json", "--pixels", "10", "--mm", "1"), "none.json: no such calibration"),
    (("calibrate", "compute", "none"), "none: holds no photos of a board; begin with `rig calibrate run none`"),
    (
        ("calibrate", "camera", "c", "--sim", "--squares", "9by6"),
        "--squares '9by6' asked; write how many squares across",
    ),
    (("calibrate", "camera", "c", "--sim", "--dictionary", "DICT_9X9"), "'DICT_9X9' is no marker dictionary of OpenCV"),
    (("calibrate", "camera", "c", "--sim", "--leave-out", "0001"), "no photo of camera that counts is called 0001"),
    (("calibrate", "poses", "c", "--sim", "--scene", "thin_cone", "--wet"), "this rig has no tank"),
    (("calibrate", "run", "c", "--sim", "--sim-wire"), "leave out one of them"),
    (("capture", "--session", "s", "--sim", "--config", "rig.toml"), "leave out one of them"),
    (("capture", "--session", "s", "--sim", "--scene", "nowhere"), "no scene 'nowhere': choose one of bottle"),
    (("capture", "--session", "s", "--sim", "--step-px", "500"), "a sweep needs at least 3"),
    (("plan", "--sim", "--width-px", "5000"), "the stripe is width_px 5000 wide, the display has 256 columns"),
    (("plan", "--sim", "--width-px", "256"), "a stripe that fills the display tells no place"),
    (("capture", "--session", "s", "--sim", "--step-px", "0.00001"), "a sweep may have 300000 at most"),
    (("capture", "--session", "s", "--sim", "--step-px", "1e-308"), "takes more than 300000 places"),
    (
        ("capture", "--session", "s", "--sim", "--width-px", "-3"),
        "capture.stripe.width_px: must be greater than 0, found -3.0",
    ),
    (("capture", "--session", "s", "--sim", "--resume"), "s: no such folder"),
    (("capture", "--session", "s", "--sim", "--resume", "--step-px", "2"), "leave out the other options"),
    (("capture", "--session", "full", "--sim"), "full: not empty; choose a new folder"),
    (("capture", "--session", "full/file/s", "--sim"), "full/file/s: cannot be written (Not a directory)"),
    (("capture", "--session", "full", "--sim", "--resume"), "no manifest.json here"),
    (("simulate", "full", "s"), "no scene 'full'"),
    (("simulate", "full/file", "s"), "is not TOML"),
    (("simulate", "full/photo", "s"), "is not a text file"),
    (("stage", "where", "--state", "bench.json", "--config", "full/good.toml"), "add --sim, or leave them out"),
    (("simulate", "hemisphere", "full"), "full: not empty"),
    (("plan", "full/file"), "not TOML"),
    (("init", "full/file"), "exists already and is kept as it is"),
    (("init", "absent/rig.toml"), "absent/rig.toml: No such file or directory"),
    (("stage", "move", "31", "--sim", "--home"), "stage: 31 mm asked, travel is 0 to 30 mm"),
    (("stage", "move", "20", "--sim"), "it was not homed; run `rig stage home` first"),
    (("stage", "where", "--sim", "--state", "full/file"), "not the state of a simulated rig"),
    (("pump", "fill", "6001", "--sim"), "and may hold 6000 ml; fill less"),
    (("pump", "fill", "0", "--sim"), "needs a volume above 0 ml"),
    (("pump", "fill", "nan", "--sim"), "needs a volume above 0 ml"),
    (("pump", "status", "--sim", "--scene", "thin_cone"), "this rig has no pump"),
]


@pytest.mark.parametrize(
    ("arguments", "said"), WRONG, ids=lambda value: " ".join(value) if isinstance(value, tuple) else ""
)
def test_a_mistake_costs_one_sentence(rig: Run, tmp_path: Path, arguments: tuple[str, ...], said: str) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full/file").write_text("this is = = not TOML")
    (tmp_path / "full/photo").write_bytes(b"\xff\xd8\xff")
    (tmp_path / "full/good.toml").write_text((resources.files("rig") / "template.toml").read_text("utf-8"))
    code, out, err = rig(*arguments)
    assert code == 1
    assert out == ""
    assert err.startswith("rig: ")
    assert said in err
    assert err.count("\n") == 1
    assert (tmp_path / "full/file").read_text() == "this is = = not TOML"
    assert not (tmp_path / "s").exists()


def test_a_person_who_stops_a_command_is_told_so(rig: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("rig.cli.scene_names", stopped)
    assert rig("scenes") == (130, "", "rig: interrupted\n")


def test_real_and_simulated_photos_never_share_a_session(rig: Run, captured: Path) -> None:
    code, _, err = rig("capture", "--resume", "--session", str(captured))
    assert code == 1
    assert "was begun with simulated devices; add --sim" in err


def test_a_damaged_manifest_is_refused_in_one_sentence(rig: Run, tiny_arguments, tmp_path: Path) -> None:
    rig("simulate", "semi_ellipsoid", "s", *tiny_arguments)
    whole = json.loads((tmp_path / "s/manifest.json").read_text())
    for part, key in (("scene", "stage_positions_mm"), ("rig", "stage")):
        damaged = json.loads(json.dumps(whole))
        damaged["provenance"]["configuration"][part][key] = 7
        (tmp_path / "s/manifest.json").write_text(json.dumps(damaged))
        code, _, err = rig("capture", "--resume", "--sim", "--session", "s")
        assert code == 1
        assert key in err
        assert err.count("\n") == 1


def test_the_simulated_tank_keeps_its_liquid_between_commands(rig: Run) -> None:
    kept = ("--sim", "--state", "bench.json")
    for arguments, said, tank_ml in (
        (("fill", "1500"), "1500 ml counted", 1500),
        (("status",), "stands still", 1500),
        (("drain", "500"), "500 ml counted", 1000),
        (("stop",), "stands still", 1000),
    ):
        lines = rig("pump", *arguments, *kept)[1].splitlines()
        assert lines[0] == f"pump: {said}"
        assert lines[1].startswith(f"tank: {tank_ml} ml of 6000 ml (measured at ")
        assert lines[2].startswith(f"reservoir: {4200 - tank_ml} ml of 4200 ml (counted at ")  # 1.05 times the fill
    assert rig("pump", "fill", "5001", *kept)[0] == 1


def test_the_simulated_stage_stays_homed_and_where_it_is_between_commands(rig: Run) -> None:
    kept = ("--sim", "--state", "bench.json")
    assert "cannot be trusted" in rig("stage", "where", *kept)[1]
    assert rig("stage", "home", *kept)[1] == "stage: 0.000 mm of 0 to 30 mm\n"
    assert rig("stage", "move", "12.5", *kept)[1] == "stage: 12.500 mm of 0 to 30 mm\n"
    assert rig("stage", "where", *kept)[1] == "stage: 12.500 mm of 0 to 30 mm\n"


def test_a_capture_starts_from_the_tank_as_it_is(rig: Run, tiny_arguments, tmp_path: Path) -> None:
    rig("pump", "fill", "1500", "--sim", "--state", "bench.json")
    code, _, err = rig("capture", "--sim", "--state", "bench.json", "--session", "s", *tiny_arguments)
    assert (code, err) == (0, "")
    entries = [json.loads(line) for line in (tmp_path / "s/journal.jsonl").read_text().splitlines()]
    flows = [(entry["event"], entry["volume_ml"]) for entry in entries if "volume_ml" in entry]
    assert flows == [("drain_started", 1500.0), ("fill_started", 4000.0), ("drain_started", 4000.0)]


def test_the_plan_ends_with_what_it_costs(rig: Run) -> None:
    code, out, _ = rig("plan", "--scene", "semi_ellipsoid", "--order", "paper", "--step-px", "4")
    assert code == 0
    # The paper's order needs the display moved once between its two positions, after it was moved to the first.
    assert out.splitlines()[-1].startswith(
        "4 sets, 520 photos, 2 moves of the stage, 2 fills and 2 drains (16.0 l pumped), 0 questions to the operator"
    )
    assert "sweep pos0_liquid along x" in out


def test_the_list_of_scenes_is_that_of_the_simulator_and_each_can_be_planned(rig: Run) -> None:
    code, out, _ = rig("scenes")
    assert code == 0
    assert [line.split()[0] for line in out.splitlines()] == list(scene_names())
    for name in scene_names():
        config_of_scene(open_scene(name, SceneOptions()), SceneOptions())


@pytest.mark.parametrize("command", ["capture", "simulate", "plan", "init", "scenes", "stage", "pump"])
def test_each_command_explains_itself(rig: Run, command: str) -> None:
    code, out, _ = rig(command, "--help")
    assert code == 0
    assert "Usage: rig " + command in out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("plan", "--sim", "--profile", "round"), "'--profile': 'round' is not one of 'hard', 'raised_cosine'."),
        (("plan", "--sim", "--step-px", "x"), "'--step-px': must be a number, found 'x'."),
        (("plan", "--sim", "--size", "0"), "'--size': must be 16 or more, found '0'."),
        (("plan", "--sim", "--size", "3"), "'--size': must be 16 or more, found '3'."),
        (("stage", "move", "far", "--sim"), "'MM': must be a number, found 'far'."),
    ],
)
def test_a_wrong_value_of_an_option_is_refused_in_plain_words(rig: Run, arguments: tuple[str, ...], said: str) -> None:
    code, out, err = rig(*arguments)
    assert (code, out) == (2, "")
    assert err.splitlines()[-1] == f"Error: Invalid value for {said}"


def test_a_wrong_value_of_a_scene_is_refused_in_plain_words(rig: Run, tmp_path: Path) -> None:
    text = (resources.files("sim_backend") / "scenes/hemisphere.toml").read_text("utf-8")
    (tmp_path / "mine.toml").write_text(text.replace("n_object = 1.5195", "n_object = 0.5"))
    code, _, err = rig("simulate", "mine.toml", "s")
    assert (code, err) == (1, "rig: scene 'mine.toml': n_object: must be 1 or more, found 0.5\n")
