"""Lens calibration: the truth lies where the covariance says, and the files of others hold the same lens."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.stats import chi2
from typer.testing import CliRunner

from longreach.cli import app
from longreach.lens_calibrate_command import write_lens
from server.calibration.lens_fit import BoardView, LensFitError, coverage_of, fit_lens
from server.camera.rectification_reading import CalibrationText, parse_calibration

SIZE = (1280, 720)
LENSES = np.array(
    [
        [700.0, 702.0, 641.0, 359.0, -0.17, 0.03, 3e-4, -2e-4, -0.002],
        [705.0, 706.0, 637.0, 362.0, -0.16, 0.025, -2e-4, 1e-4, 0.001],
    ]
)
RIG = np.array([0.003, 0.01, -0.004, -0.12, 0.0005, -0.001])
SIGMA_PX = 0.1
GRID = np.array([[0.03 * i, 0.03 * j, 0.0] for j in range(1, 8) for i in range(1, 11)])


def matrix(lens: np.ndarray) -> np.ndarray:
    return np.array([[lens[0], 0.0, lens[2]], [0.0, lens[1], lens[3]], [0.0, 0.0, 1.0]])


def views(seed: int, eyes: int, n: int = 14, tilt: float = 0.5) -> list[BoardView]:
    rng = np.random.default_rng(seed)
    out: list[BoardView] = []
    while len(out) < n:
        turn = tilt * rng.uniform(-1.0, 1.0, 3)
        board = np.concatenate([turn, rng.uniform([-0.35, -0.25, 0.35], [0.1, 0.05, 0.7])])
        seen: list[tuple[np.ndarray, np.ndarray] | None] = []
        for eye in range(eyes):
            r, t = board[:3], board[3:]
            if eye == 1:
                r, t = cv2.composeRT(r, t, RIG[:3], RIG[3:])[:2]
            px = cv2.projectPoints(GRID, r, t, matrix(LENSES[eye]), LENSES[eye, 4:])[0].reshape(-1, 2)
            inside = ((px > 5.0) & (px < np.array(SIZE) - 5.0)).all(axis=1)
            seen.append((GRID[inside], px[inside] + SIGMA_PX * rng.standard_normal(px[inside].shape)))
        if all(one is not None and len(one[0]) > 20 for one in seen):
            out.append(BoardView(f"view{len(out)}", tuple(seen)))
    return out


@pytest.mark.parametrize("eyes", [1, 2])
def test_the_truth_lies_where_the_covariance_says(eyes: int) -> None:
    truth = np.concatenate([LENSES[:eyes].ravel(), *([RIG] if eyes == 2 else [])])
    inside, chi2s = [], []
    for seed in range(24):
        fit = fit_lens(views(seed, eyes), SIZE)
        error = fit.values - truth
        inside.append(np.abs(error) < 1.96 * np.sqrt(np.diag(fit.covariance)))
        chi2s.append(float(error @ np.linalg.solve(fit.covariance, error)))
        assert fit.rms_px == pytest.approx(SIGMA_PX, rel=0.1)
    assert np.mean(inside) == pytest.approx(0.95, abs=0.03)
    total = sum(chi2s)
    low, high = chi2.ppf([1e-4, 1.0 - 1e-4], len(truth) * len(chi2s))
    assert low < total < high


def test_other_programs_read_the_same_rig(tmp_path: Path) -> None:
    fit = fit_lens(views(1, 2), SIZE)
    written, notes = write_lens(fit, tmp_path)
    assert {path.name for path in written} == {"left.yaml", "right.yaml", "kalibr.yaml", "opencv.yaml", "zed.conf"}
    assert not notes
    text = {path.name: CalibrationText(path.name, path.read_text(encoding="utf-8")) for path in written}
    for files in (("zed.conf",), ("opencv.yaml",), ("kalibr.yaml",), ("left.yaml", "right.yaml")):
        rig = parse_calibration([text[name] for name in files], SIZE)
        for eye, found in enumerate((rig.left, rig.right)):
            kept = 4 if files == ("kalibr.yaml",) else 5
            numbers = [found.fx_px, found.fy_px, found.cx_px, found.cy_px, *found.distortion[:kept]]
            assert np.abs(np.array(numbers) - fit.lens_parameters[eye, : 4 + kept]).max() < 1e-9, files
        assert fit.rig_parameters is not None
        assert np.abs(rig.t_right_left_m - fit.rig_parameters[3:]).max() < 1e-9, files
        assert np.abs(cv2.Rodrigues(rig.R_right_left)[0].ravel() - fit.rig_parameters[:3]).max() < 1e-9, files


def test_views_that_cannot_tell_are_refused_and_a_bent_one_is_left_out() -> None:
    with pytest.raises(LensFitError, match="at least 6"):
        fit_lens(views(1, 1)[:5], SIZE)
    several = views(2, 1)
    points, px = several[3].eye_correspondences[0] or (np.zeros(0), np.zeros(0))
    bent = px + np.random.default_rng(0).normal(scale=3.0, size=px.shape)
    several[3] = BoardView("bent", ((points, bent),))
    fit = fit_lens(several, SIZE)
    assert [name for name, _ in fit.dropped_views] == ["bent"]
    flat = coverage_of(views(3, 1, tilt=0.05), fit_lens(views(3, 1, tilt=0.05), SIZE))
    assert any("tilt the board" in text for text in flat.advice)


def test_pictures_of_a_board_give_the_lens_they_were_made_with(tmp_path: Path) -> None:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    board = cv2.aruco.CharucoBoard((11, 8), 0.03, 0.022, dictionary)
    scale = 4000.0  # pixels of the drawing per metre
    drawn = board.generateImage((int(0.33 * scale), int(0.24 * scale)), marginSize=0, borderBits=1)
    K, rng = matrix(LENSES[0]), np.random.default_rng(5)
    for k in range(12):
        R = cv2.Rodrigues(0.5 * rng.uniform(-1.0, 1.0, 3))[0]
        t = rng.uniform([-0.25, -0.18, 0.35], [0.0, -0.05, 0.6])
        H = K @ np.column_stack([R[:, 0] / scale, R[:, 1] / scale, t]) @ np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
        picture = cv2.warpPerspective(drawn, H, SIZE, flags=cv2.INTER_AREA, borderValue=160)
        cv2.imwrite(str(tmp_path / f"{k:02}.png"), cv2.GaussianBlur(picture, (3, 3), 0.7))
    call = [
        "camera",
        "calibrate",
        str(tmp_path),
        "--mono",
        "--squares",
        "11x8",
        "--square-mm",
        "30",
        "--marker-mm",
        "22",
    ]
    done = CliRunner().invoke(app, [*call, "--json", str(tmp_path / "a.json"), "--out", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    answer = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    for name, true, limit in (("fx_px", 700.0, 1.5), ("fy_px", 702.0, 1.5), ("cx_px", 641.0, 1.5), ("k1", 0.0, 0.01)):
        assert answer["values"][f"lens.{name}"] == pytest.approx(true, abs=limit)
    assert answer["rms_px"] < 0.2
    assert (tmp_path / "out" / "camera.yaml").exists()
    assert "no ZED conf" in done.output
