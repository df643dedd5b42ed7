"""Units are guessed from sizes: what has its size for another reason is let through, what is in a wrong unit is not."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from diagnosis_cases import MACHINE_TOML
from one_joint_cases import Machine, recorded

from diagnosis.reading.read import Read, examine_recording, read_for_diagnosis
from recording.content import Recording
from recording.rows import StaticPoint
from recording.run import RunInfo

SHORT = Machine(prismatic=True, kinds=("steps",))
PLACED = "\n[tracker]\nT_base_tracker = [1, 0, 0, 0,  0, 1, 0, 0,  0, 0, 1, 0,  0, 0, 0, 1]\n"


def codes(result: Read) -> set[str]:
    return {one.code for one in result.findings}


def slid(place: Path, scale: float, shift: float) -> Path:
    """A cylinder's log with other strokes: reference and encoder are the second and third column."""
    path = recorded(place, SHORT)
    header, *rows = (path / "plc.csv").read_text(encoding="utf-8").splitlines()
    cells = np.array([[float(cell) for cell in row.split(",")] for row in rows])
    cells[:, 1:3] = scale * cells[:, 1:3] + shift
    lines = [",".join(f"{x:.9f}" for x in row) for row in cells]
    (path / "plc.csv").write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")
    return path


def test_a_long_telescope_is_not_in_degrees(tmp_path: Path) -> None:
    result = read_for_diagnosis(slid(tmp_path, 1.0, 9.0))
    assert "degrees" not in codes(result)
    assert result.has_judgeable_stage


def test_a_telescope_in_millimetres_is(tmp_path: Path) -> None:
    result = read_for_diagnosis(slid(tmp_path, 1e3, 9e3))
    (one, other) = [one for one in result.findings if one.code == "millimetres"]
    assert one.severity == other.severity == "fatal"
    assert "q_1_m reaches 9" in str(other)


def test_limits_of_what_slides_are_told_in_metres(tmp_path: Path) -> None:
    path = slid(tmp_path, 1.0, 2.0)
    text = (path / "machine.toml").read_text(encoding="utf-8")
    (path / "machine.toml").write_text(text.replace("[plc]", "q_min_m = 0.0\nq_max_m = 1.0\n[plc]"), encoding="utf-8")
    (one,) = [one for one in read_for_diagnosis(path).findings if one.code == "machine_mismatch"]
    assert "q_1_m lies at 1." in one.text
    assert "m, outside its limits 0 .. 1 m" in one.text


def commanded(tmp_path: Path, change: Callable[[np.ndarray], np.ndarray]) -> Read:
    """A cylinder's log with other valve commands, which are its last column."""
    path = recorded(tmp_path, SHORT)
    header, *rows = (path / "plc.csv").read_text(encoding="utf-8").splitlines()
    cut = [row.rsplit(",", 1) for row in rows]
    u = change(np.array([float(last) for _, last in cut]))
    lines = [f"{rest},{number:.9f}" for (rest, _), number in zip(cut, u, strict=True)]
    (path / "plc.csv").write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")
    return read_for_diagnosis(path)


def test_a_spike_of_a_command_is_no_percent(tmp_path: Path) -> None:
    def spiked(u: np.ndarray) -> np.ndarray:
        u[100:103] = 1.6
        return u

    result = commanded(tmp_path, spiked)
    (one,) = [one for one in result.findings if one.code == "beyond_full"]
    assert one.severity == "note"
    assert "u_1_frac reaches 1.6, beyond full command 1, in 3 of" in one.text
    assert "percent" not in codes(result)
    assert result.has_judgeable_stage


def test_percent_is_told_with_its_column(tmp_path: Path) -> None:
    (one,) = [one for one in commanded(tmp_path, lambda u: 100.0 * u).findings if one.code == "percent"]
    assert one.severity == "fatal"
    assert "u_1_frac reaches" in one.text


def seen(toml: str, scale: float, shift: tuple[float, float, float]) -> Read:
    rng = np.random.default_rng(2)
    places = scale * rng.uniform(-2.0, 2.0, (20, 3)) + np.array(shift)
    rows = [StaticPoint(k, (0.01 * k,) * 6, "p", *place) for k, place in enumerate(places.tolist())]
    rows.append(StaticPoint(99, (0.0,) * 6, "p", 0.0, 0.0, 0.0))  # a prism that was lost
    return examine_recording(
        Recording("folder", RunInfo("x"), f"{toml}\n[points]\np = {{ joint = 6 }}\n", tuple(rows)), Path("x")
    )


@pytest.mark.parametrize(
    ("toml", "scale", "shift", "found"),
    [
        (MACHINE_TOML, 1.0, (385_000.0, 6_672_000.0, 100.0), False),
        (MACHINE_TOML, 1e3, (385_000.0, 6_672_000.0, 100.0), True),
        (MACHINE_TOML, 1e3, (0.0, 0.0, 0.0), True),
        (MACHINE_TOML + PLACED, 1.0, (385_000.0, 6_672_000.0, 100.0), True),
        (MACHINE_TOML + PLACED, 1.0, (0.0, 0.0, 0.0), False),
    ],
)
def test_a_tracker_may_count_in_a_towns_coordinates(
    toml: str, scale: float, shift: tuple[float, float, float], found: bool
) -> None:
    assert ("millimetres" in codes(seen(toml, scale, shift))) == found
