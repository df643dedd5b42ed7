"""Encoders whose log was filtered: not lags of every valve, and not a tracker's clock."""

from pathlib import Path

import numpy as np
import pytest
from foreign_plant import Fault, rewritten, write

from diagnosis.answer import answer
from diagnosis.diagnose import diagnose
from diagnosis.reading.read import read

FILTER_S = 0.04


def filtered(rows: list) -> None:
    """A log as one writes it that smooths the encoders, by a pole at FILTER_S."""
    t = np.array([float(row["t_plc_s"]) for row in rows])
    share = np.where(np.diff(t) < 0.5, 1.0 - np.exp(-np.diff(t) / FILTER_S), 1.0)
    for name in ("q_1_rad", "q_2_rad"):
        q = float(rows[0][name])
        for row, part in zip(rows[1:], share, strict=True):
            q += part * (float(row[name]) - q)
            row[name] = f"{q!s}"


@pytest.mark.parametrize("tracker_m", [2e-4, pytest.param(0.0, marks=pytest.mark.slow)])
def test_a_filtered_log_is_told_as_one_cause(tmp_path: Path, tracker_m: float) -> None:
    place = write(tmp_path / "run", Fault(), seconds=10.0, tracker_m=tracker_m)
    found = answer(diagnose(read(rewritten(place, filtered))))
    assert found["verdict"] == ("outside" if tracker_m else "undecided"), found["why"]
    assert "joints 1, 2 all lag by 3" in found["why"]
    assert ("as much earlier: the encoders' log is filtered or late" in found["why"]) == (tracker_m > 0.0)


@pytest.mark.parametrize(("lag_s", "hinted"), [((FILTER_S, FILTER_S), True), ((FILTER_S, 0.0), False)])
def test_lags_of_valves_stay_lags(tmp_path: Path, lag_s: tuple[float, float], hinted: bool) -> None:
    """Of both joints by the same the log alone cannot tell; what a tracker sees at the right time clears the log."""
    place = write(tmp_path / "run", Fault(lag_s=lag_s), seconds=10.0, tracker_m=2e-4)
    found = answer(diagnose(read(place)))
    assert found["verdict"] == "effects", found["why"]
    named = {(one["name"], one["joint"]) for one in found["hypotheses"][0]["effects"]}
    assert named == {("valve_lag", joint) for joint, one in enumerate(lag_s, start=1) if one > 0.0}
    assert ("all lag by" in found["why"]) == hinted
