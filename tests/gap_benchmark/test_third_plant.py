"""The third plant against the contract's nominal model and against recordings that others made of the same machine."""

import ast
import csv
import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from benchmarks.diagnosis.sealed import third_camera as camera
from benchmarks.diagnosis.sealed import third_cases as cases
from benchmarks.diagnosis.sealed.third_arm import Array, rotation
from benchmarks.diagnosis.sealed.third_dynamics import BIAS, DISTURBANCE_MEMORY, Motion, drive_of, run
from benchmarks.diagnosis.sealed.third_plant import KINDS, PIXEL, PLACE_M, SPEED_RAD_S, digest, draw, write_case
from benchmarks.diagnosis.sealed.third_truth import Weighed, plant_of, scene_of

SEALED = Path(__file__).parents[2] / "benchmarks" / "diagnosis" / "sealed"
SHARED = Path(__file__).resolve().parents[3] / "shared" / "data" / "gap" / "many_at_once"
needs_shared = pytest.mark.skipif(not SHARED.is_dir(), reason=f"the shared recordings are not at {SHARED}")
MACHINE = cases.machine_of(np.random.default_rng(3), 6)
HOME = np.deg2rad([10.0, 35.0, -75.0, 5.0, 40.0, 5.0])
MACHINE_CAMERA = np.array(MACHINE["camera"]["T_tcp_cam_left"]).reshape(4, 4)
SENT = HOME + 0.1 * np.sin(np.linspace(0.0, 9.0, 400))[:, None] * np.linspace(0.6, 1.4, 6)
SENT[200:] += 0.15  # a jump shows how fast a spool may move, and fills the clip
SIZE = {  # the shared truth gives one number an effect; the rest is in its README or was fitted to its pixels
    "valve_deadband": "half_width_frac",
    "flow_gain_error": "gain_frac",
    "encoder_bias": "bias_rad",
    "gravity_sag": "compliance_rad_nm",
    "link_length_error": "error_m",
    "hand_eye_rotation": "angle_rad",
    "hand_eye_translation": "distance_m",
    "camera_latency": "latency_s",
}


def quiet(effects: list[dict[str, Any]], sent: Array = SENT, machine: dict[str, Any] = MACHINE) -> Motion:
    return run(drive_of(machine, effects), sent, np.zeros_like(sent), np.random.default_rng(0))


def test_it_imports_nothing_of_simulator_effects_or_diagnosis() -> None:
    for path in SEALED.glob("third_*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in names:
                ours = name.startswith(("machine", "sim_plc", "diagnosis", "server", "recording", "longreach"))
                assert not ours, f"{path.name} imports {name}"
                if name.startswith("benchmarks."):
                    assert name == "benchmarks.diagnosis.sealed" or ".third_" in name


def test_without_effects_it_is_the_nominal_model_of_the_contract() -> None:
    """The contract's equations once more, in plain Python."""
    motion, joints = quiet([]), MACHINE["joint"]
    q, x, xd, lagged = SENT[0].copy(), np.zeros(6), np.zeros(6), np.zeros(6)
    kp, tau, kv, hz, zeta = (
        np.array([joint[key] for joint in joints])
        for key in ("kp_frac_per_rad", "pt1_tau_s", "velocity_gain_rad_s", "valve_frequency_hz", "valve_damping")
    )
    share = np.where(tau > 0.0, 1.0 - np.exp(-0.01 / np.where(tau > 0.0, tau, 1.0)), 1.0)
    wn = 2.0 * np.pi * hz
    for k in range(len(SENT)):
        reading = np.round(q * 262144 / (2.0 * np.pi)) * 2.0 * np.pi / 262144
        np.testing.assert_allclose(motion.encoder[k], reading, atol=1e-9)
        lagged += share * (kp * (SENT[max(k - 1, 0)] - reading) - lagged)
        u = np.clip(lagged, -1.0, 1.0)
        np.testing.assert_allclose(motion.u[k], u, atol=1e-9)
        for _ in range(10):
            xd = xd + 0.001 * (wn**2 * (u - x) - 2.0 * zeta * wn * xd)
            x = x + 0.001 * xd
            q = q + 0.001 * kv * x


@pytest.mark.parametrize("kind", [*cases.CATALOGUE, *cases.FOREIGN], ids=lambda kind: kind.name)
def test_every_effect_is_seen_in_some_signal(kind: cases.Kind) -> None:
    joint = None if kind.joints is None else (kind.joints or (3,))[-1]
    effect = {"name": kind.name, "joint": joint, "parameters": kind.draw(np.random.default_rng(1), joint or 0)}
    if kind.name == "cable_tug":
        effect["parameters"]["from_rad"] = float(HOME[(joint or 1) - 1])
    base = [
        {"name": "gravity_sag", "joint": 2, "parameters": {"compliance_rad_nm": 1e-6}}
    ]  # a rigid arm has no payload
    signals = []
    for effects in (base, [*base, effect]):
        plant, motion = plant_of(MACHINE, effects), quiet(effects)
        frames = plant.arm.frames(motion.link[::40])
        T_cam_ooi = np.diag([1.0, -1.0, -1.0, 1.0])
        T_cam_ooi[2, 3] = 1.0
        seen = np.linalg.inv(plant.eyes.T_tcp_cam) @ MACHINE_CAMERA @ T_cam_ooi[None].repeat(2, axis=0)
        pixels = camera.project(plant.eyes, seen, np.ones(2))
        shutter = camera.shuttered(plant.eyes, 0.01, pixels, pixels + 1.0)
        signals.append((motion.encoder, motion.u, motion.ref, frames, shutter, plant.eyes.stamp(np.array([0.0, 1.0]))))
    assert any(np.abs(a - b).max() > 1e-7 for a, b in zip(*signals, strict=True))


def test_a_case_is_sealed_and_the_same_again(tmp_path: Path) -> None:
    case = draw("single", 9, 9, shorten=0.1)
    truth = write_case(case, tmp_path / "a")
    write_case(draw("single", 9, 9, shorten=0.1), tmp_path / "b")
    written = sorted(path.name for path in (tmp_path / "a").iterdir())
    assert {"machine.toml", "run.toml", "seal.json", "sent.csv", "plc.csv", "markers.csv", "static.csv"} <= set(written)
    for name in written:
        if name != "run.toml":
            assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    stored = json.loads(json.dumps({"case": truth}))["case"]
    assert json.loads((tmp_path / "a" / "seal.json").read_text(encoding="utf-8"))["sha256"] == digest(stored)
    assert "effect" not in tomllib.loads((tmp_path / "a" / "machine.toml").read_text(encoding="utf-8"))
    assert truth["effects"][0]["name"] == cases.CATALOGUE[9].name


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_draws_its_effects(kind: str) -> None:
    case = draw(kind, 1, 2, shorten=0.1)
    foreign = [effect for effect in case.effects if not effect.get("catalogue", True)]
    expected = {"none": (0, 0), "one": (1, 1), "foreign": (1, 1), "many": (8, 20), "foreign_many": (9, 21)}[
        KINDS[kind][0]
    ]
    assert expected[0] <= len(case.effects) <= expected[1]
    assert len(foreign) == (1 if "foreign" in kind else 0)
    repeats = [segment for segment in case.segments if segment.repeat_of]
    assert len(repeats) == (4 if case.recording.programme == "identify" else 0)


def test_a_length_is_worth_its_error_and_a_dead_band_what_it_holds_back() -> None:
    effects = [
        {"name": "link_length_error", "joint": 2, "parameters": {"error_m": 0.004, "of": "a"}},
        {"name": "valve_deadband", "joint": 1, "parameters": {"half_width_frac": 0.03}},
    ]
    scene = scene_of(MACHINE, SENT, np.eye(4), np.random.default_rng(1))
    weighed = Weighed(scene, effects)
    length, band = weighed.worth(effects[1:]), weighed.worth(effects[:1])
    assert length["tip_mm"] == pytest.approx(4.0, abs=1e-6)
    assert length["tracking_mm"] == pytest.approx(0.0, abs=1e-6)
    assert band["static_mm"] == pytest.approx(0.0, abs=1e-6)
    assert 1.0 < (band["tracking_mm"] or 0.0) < 1e3 * 5.0 * 0.03 / 6.0  # at most the joint error times the reach


def shared_effects(name: str) -> list[dict[str, Any]]:
    effects = json.loads((SHARED / "truth.json").read_text(encoding="utf-8"))[name]["effects"]
    more = {
        "hand_eye_rotation": {"axis": [5.0, 2.0, 1.0]},
        "hand_eye_translation": {"direction": (np.array([6.0, 7.0, 4.0]) / 101.0**0.5).tolist()},
    }
    out = []
    for effect in effects:
        values = {SIZE[effect["name"]]: effect["value"]} | more.get(effect["name"], {})
        if effect["name"] == "link_length_error":
            values["of"] = "a" if effect["joint"] == 2 else "d"
        detail = {"in_band_frac": 0.02} if effect["name"] == "valve_deadband" else {}
        out.append({"name": effect["name"], "joint": effect["joint"], "parameters": values, "detail": detail})
    return out


def shared_machine(name: str) -> dict[str, Any]:
    return tomllib.loads((SHARED / name / "machine.toml").read_text(encoding="utf-8"))


def table(path: Path, columns: tuple[str, ...]) -> Array:
    with path.open(encoding="utf-8") as file:
        return np.array([[float(row[column]) for column in columns] for row in csv.DictReader(file)])


def six(form: str) -> tuple[str, ...]:
    return tuple(form.format(j) for j in range(1, 7))


@needs_shared
@pytest.mark.parametrize(("name", "level"), [("case_001", 1.0), ("case_002", 3.0)])
def test_the_shared_recordings_are_reproduced_to_their_noise(name: str, level: float) -> None:
    """Each signal's difference is the noise that those recordings have, as far as it can be known from them."""
    machine, effects = shared_machine(name), shared_effects(name)
    plant = plant_of(machine, effects)
    sent = table(SHARED / name / "sent.csv", six("q_sent_{}_rad"))
    logged = table(SHARED / name / "plc.csv", (*six("q_ref_{}_rad"), *six("q_{}_rad"), *six("u_{}_frac")))
    ref, encoder, u = logged[:, :6], logged[:, 6:12], logged[:, 12:]
    calm = quiet(effects, sent, machine)
    np.testing.assert_array_equal(calm.ref, ref)
    scatter_q, scatter_u = [], []
    for seed in range(6):  # what the plant's own disturbance makes of the same command
        rng = np.random.default_rng(seed)
        shock = SPEED_RAD_S * level * np.sqrt(1.0 - DISTURBANCE_MEMORY**2) * rng.normal(size=sent.shape)
        other = run(plant.drive, sent, shock, rng)
        scatter_q.append(np.sqrt(((other.encoder - calm.encoder) ** 2).mean()))
        scatter_u.append(np.sqrt(((other.u - calm.u) ** 2).mean()))
    off_q, off_u = (np.sqrt(((a - b) ** 2).mean()) for a, b in ((calm.encoder, encoder), (calm.u, u)))
    assert off_q == pytest.approx(np.mean(scatter_q), rel=0.15)
    assert off_u == pytest.approx(np.mean(scatter_u), rel=0.15)
    static = table(SHARED / name / "static.csv", (*six("q_{}_rad"), "x_m", "y_m", "z_m"))
    points = tuple((point["joint"], np.array(point["xyz_m"])) for point in machine["points"].values())
    places = plant.arm.points(static[::2, :6] - plant.drive.table[:, BIAS], points)
    assert np.sqrt(((places.reshape(-1, 3) - static[:, 6:]) ** 2).mean()) == pytest.approx(PLACE_M * level, rel=0.1)
    off_px = corners_off(name, machine, plant, encoder)
    assert off_px == pytest.approx(PIXEL * level, rel=0.03)


def corners_off(name: str, machine: dict[str, Any], plant: Any, encoder: Array) -> float:
    """RMS [px] of the corners; where the object stands is not in the files and is fitted (six numbers)."""
    with (SHARED / name / "markers.csv").open(encoding="utf-8") as file:
        rows = [row for k, row in enumerate(csv.reader(file)) if k % 30 == 1]
    stamps = np.array([float(row[0]) for row in rows])
    eye, marker = (
        np.array(column) for column in zip(*[(row[1] == "right", int(row[2]) - 10) for row in rows], strict=True)
    )
    pixels = np.array([row[3:] for row in rows], dtype=float).reshape(-1, 4, 2)
    t = 0.01 * np.arange(len(encoder))
    true = encoder - plant.drive.table[:, BIAS]
    angles = np.stack([np.interp(stamps - plant.eyes.offset_s, t, column) for column in true.T], axis=1)
    T_base_cam = plant.arm.frames(angles)[:, -1] @ plant.eyes.T_tcp_cam
    ahead = np.diag([1.0, -1.0, -1.0, 1.0])
    ahead[2, 3] = 1.0
    start = T_base_cam[0] @ ahead

    def off(x: Array) -> Array:
        T = start.copy()
        T[:3, :3], T[:3, 3] = (
            start[:3, :3] @ rotation(x[:3] + 1e-12, float(np.linalg.norm(x[:3]))),
            start[:3, 3] + x[3:],
        )
        drawn = camera.project(plant.eyes, np.linalg.inv(T_base_cam) @ T, np.zeros(len(T_base_cam)))
        return (drawn[np.arange(len(rows)), eye.astype(int), marker] - pixels).ravel()

    found = least_squares(off, np.zeros(6), x_scale=0.1)
    return float(np.sqrt((found.fun**2).mean()))


@needs_shared
def test_an_effects_worth_at_the_tip_is_the_shared_truths() -> None:
    """Over other random postures than theirs: the RMS of 200 differs by a few per cent."""
    effects = shared_effects("case_001")
    theirs = json.loads((SHARED / "truth.json").read_text(encoding="utf-8"))["case_001"]
    scene = scene_of(shared_machine("case_001"), None, np.eye(4), np.random.default_rng(1))
    weighed = Weighed(scene, effects)
    assert weighed.worth([])["posture_mm"] == pytest.approx(theirs["nominal_tip_mm"], rel=0.1)
    for k, effect in enumerate(theirs["effects"]):
        mine = weighed.worth(effects[:k] + effects[k + 1 :])["posture_mm"]
        assert mine == pytest.approx(effect["tip_mm"], rel=0.1, abs=1e-6), effect["name"]
