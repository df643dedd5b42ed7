"""The registration bench: its cases are what they say, its figures are right, and a second run resumes."""

import json

import numpy as np
import pytest

from longreach.bench_registration import run
from longreach.bench_registration.cases import CLOCK_OFFSET_S, KINDS, PATHS, draw_case, warp
from longreach.bench_registration.command import cell_figures, verdict
from longreach.bench_registration.intervals import Interval, percentile_interval, ratio_interval
from longreach.bench_registration.methods import METHODS, OURS, Trial, available_methods, try_method
from machine.rotations import geodesic_angle


@pytest.mark.parametrize("kind", KINDS)
def test_truth_of_a_case_is_consistent(kind):
    case = draw_case("folded 3-D", kind, 3)
    R = case.encoder.Ts_base_tcp[0, :3, :3] @ case.R_tcp_cam
    assert geodesic_angle(R, case.R_base_vo @ case.camera.Ts_vo_cam[0, :3, :3]) < 1e-9
    assert case.offset_s == (CLOCK_OFFSET_S if kind == "offset" else 0.0)


def test_paths_are_about_a_metre_and_as_flat_as_named():
    for name, corners in PATHS.items():
        assert np.linalg.norm(np.diff(corners, axis=0), axis=1).sum() == pytest.approx(1.0, abs=0.051)
        assert (np.ptp(corners[:, 2]) > 0.05) == (name == "folded 3-D")


def test_warp_has_its_peak():
    points = PATHS["folded 3-D"]
    field = warp(points, 0.02, np.random.default_rng(0))
    assert np.linalg.norm(field, axis=1).max() == pytest.approx(0.02)


def test_every_method_finds_an_easy_case():
    case = draw_case("folded 3-D", "noise", 5)
    for name in available_methods():
        found = try_method(name, case)
        assert found.error_deg is not None
        assert found.error_deg < (4.1 if name == "HMM with axes" else 2.5), name


def test_refusals_count_as_the_worst():
    trials = {i: {OURS: Trial(None if i < 3 else 0.1, 0.01), "Umeyama (evo)": Trial(0.2, 0.01)} for i in range(20)}
    figures = cell_figures(trials)
    assert figures.refused[OURS] == 3
    assert figures.median_deg[OURS].value == 0.1
    assert np.isinf(figures.p95_deg[OURS].value)
    assert figures.median_over_best.value == pytest.approx(0.5)


def test_intervals_hold_the_median():
    rng = np.random.default_rng(1)
    intervals = [percentile_interval(rng.normal(1.0, 0.3, 150), 50.0) for _ in range(60)]
    held = [one.low <= 1.0 <= one.high for one in intervals]
    assert np.mean(held) > 0.85
    values = rng.uniform(1.0, 2.0, 300)
    ratio = ratio_interval(0.9 * values, values, 50.0)
    assert ratio.low == pytest.approx(0.9)
    assert verdict(ratio) == "best"
    assert verdict(Interval(1.03, 1.0, 1.04)) == "within 5 %"
    assert verdict(Interval(1.2, 1.1, 1.3)) == "not best"


def test_a_second_run_resumes_and_a_cut_line_is_run_again(tmp_path, monkeypatch):
    monkeypatch.setattr(run, "CELLS", (("noise", "paper"),))
    monkeypatch.setattr(run, "available_methods", lambda: ["Umeyama (evo)"])
    whole = {"seed": 1, "methods": {"Umeyama (evo)": {"error_deg": 7.0, "seconds": 0.0}}}
    (tmp_path / "noise_paper.jsonl").write_text(json.dumps(whole) + '\n{"seed": 2, "meth', encoding="utf-8")
    found = run._on_file(tmp_path / "noise_paper.jsonl", ["Umeyama (evo)"], range(1, 3))
    assert list(found) == [1]
    assert found[1]["Umeyama (evo)"].error_deg == 7.0


def test_method_names_are_known():
    assert set(available_methods()) <= set(METHODS)
