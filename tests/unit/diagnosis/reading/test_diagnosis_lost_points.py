"""Rows of a tracker that had lost its prism are named and left out; what an arm does never is."""

import csv
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosis_cases import likely
from foreign_plant import Fault, write
from static_points import examined, static_recording

from diagnosis.answer import answer_json
from diagnosis.budget import budget_of
from diagnosis.log.findings import Finding
from diagnosis.reading.read import Read, read_for_diagnosis
from machine.effects.layout import neutral_sets
from recording.rows import StaticPoint

KINDS = ("repeat", "repeat", "workcycle")
WIDE = Fault(backlash=(0.0, 0.004))
Rows = list[list[str]]
FREE = ("T_base_tracker = ", "# T_base_tracker = ")


def made(folder: Path, fault: Fault = WIDE, frame: bool = True) -> Path:
    """A boom with play behind its encoder, its tip followed at 20 Hz."""
    out = write(folder / "run", fault, seconds=8.0, kinds=KINDS, tracker_m=2e-4)
    machine = out / "machine.toml"
    machine.write_text(machine.read_text() if frame else machine.read_text().replace(*FREE))
    return out


def spoiled(folder: Path, change: Callable[[Rows], Rows | None]) -> Path:
    """The folder with other rows in its tracker.csv."""
    with (folder / "tracker.csv").open(newline="") as file:
        header, *rows = list(csv.reader(file))
    rows = change(rows) or rows
    with (folder / "tracker.csv").open("w", newline="") as file:
        csv.writer(file).writerows([header, *rows])
    return folder


def lost(whole: Read) -> list[Finding]:
    """What was said of lost points."""
    return [one for one in whole.findings if one.code == "lost_points"]


def zeros(rows: Rows) -> None:
    """Every twelfth row for a second in which the prism was not seen."""
    for row in rows[::12]:
        row[2:] = ["0.0", "0.0", "0.0"]


def springs(rows: Rows) -> None:
    """Three single rows elsewhere, as by a mirrored beam."""
    for k, by in ((20, 0.4), (130, -0.08), (300, 2.0)):
        row = rows[k]
        row[4] = str(float(row[4]) + by)


@pytest.mark.parametrize("frame", [True, False], ids=["known frame", "free frame"])
@pytest.mark.parametrize(("change", "count"), [(zeros, 40), (springs, 3)])
def test_lost_rows_are_left_out_and_the_rest_tells_what_it_told(
    tmp_path: Path, change: Callable[[Rows], None], count: int, frame: bool
) -> None:
    whole = read_for_diagnosis(spoiled(made(tmp_path, frame=frame), change))
    (finding,) = lost(whole)
    assert finding.count == count
    found = answer_json(budget_of(whole))
    assert found["verdict"] in ("effects", "partly"), found["why"]
    (effect,) = likely(found)
    assert (effect["name"], effect["joint"]) == ("backlash", 2)
    assert effect["parameters"]["width_rad"]["value"] == pytest.approx(0.004, abs=3e-4)


@pytest.mark.parametrize(
    "fault",
    [
        Fault(),
        Fault(backlash=(0.1, 0.1)),
        Fault(bias=(0.0, 0.3)),
        Fault(trolley_m=0.3),
        Fault(backlash=(0.3, 0.0), spool_rate=(1.0, 1.0)),
    ],
)
def test_what_an_arm_does_is_never_left_out(tmp_path: Path, fault: Fault) -> None:
    assert not lost(read_for_diagnosis(made(tmp_path, fault)))


@pytest.mark.parametrize("left", [0, 1, 3, 4, 5, 9])
def test_a_handful_of_rows_is_read(tmp_path: Path, left: int) -> None:
    folder = spoiled(made(tmp_path, frame=False), lambda rows: rows[:left])
    assert not lost(read_for_diagnosis(folder))


def test_a_static_row_at_the_origin_is_no_place() -> None:
    sound = static_recording(neutral_sets(6))
    seventh = sound.rows[7]
    assert isinstance(seventh, StaticPoint)
    rows = (*sound.rows[:7], replace(seventh, x_m=0.0, y_m=0.0, z_m=0.0), *sound.rows[8:])
    whole = examined(replace(sound, rows=rows))
    (finding,) = lost(whole)
    assert (finding.count, finding.subject) == (1, "static.csv")
    assert whole.tables.static is not None
    assert np.isnan(whole.tables.static.xyz).all(axis=1).sum() == 1
