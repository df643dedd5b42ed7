"""Play behind encoders is told where a tracker and a log of angles are all there is: no valve, no command, no gain."""

from pathlib import Path

import pytest
from diagnosis_cases import likely
from foreign_plant import Fault, rewritten, write

from diagnosis.answer import answer_json
from diagnosis.budget import budget_of
from diagnosis.reading.read import read_for_diagnosis

OF_VALVES = ("velocity_gain", "valve_", "kp_frac", "pt1_tau")


def angles_only(place: Path) -> Path:
    """The folder without what a machine does not tell whose encoders alone are read."""
    toml = place / "machine.toml"
    kept = [line for line in toml.read_text(encoding="utf-8").splitlines() if not line.startswith(OF_VALVES)]
    toml.write_text("\n".join(kept) + "\n", encoding="utf-8")
    (place / "sent.csv").unlink()
    return rewritten(place, without=("q_ref", "u_", "seq"))


@pytest.mark.parametrize("delay_s", [0.0, 0.03])
def test_sent_and_received_references_alone_tell_of_the_link(tmp_path: Path, delay_s: float) -> None:
    place = write(tmp_path / "run", Fault(delay_s=delay_s), seconds=10.0)
    found = answer_json(budget_of(read_for_diagnosis(rewritten(place, without=("q_1", "q_2", "u_")))))
    assert found["verdict"] == ("effects" if delay_s else "none"), found["why"]
    named = [one["name"] for one in likely(found)]
    assert named == (["transport_delay"] if delay_s else [])
    assert "how the joints moved is not known" in str(found["missing"])


@pytest.mark.parametrize(("play_rad", "wanted"), [(0.0, set()), (0.004, {("backlash", 2)})])
def test_play_needs_no_valve(tmp_path: Path, play_rad: float, wanted: set[tuple[str, int]]) -> None:
    place = write(tmp_path / "run", Fault(backlash=(0.0, play_rad)), seconds=10.0, tracker_m=2e-4)
    found = answer_json(budget_of(read_for_diagnosis(angles_only(place))))
    first = likely(found)
    assert {(one["name"], one["joint"]) for one in first} == wanted, found["why"]
    assert found["verdict"] in (("effects", "partly") if wanted else ("none",)), found["why"]
    for one in first:
        (width,) = one["parameters"].values()
        assert width["low"] < play_rad < width["high"]
