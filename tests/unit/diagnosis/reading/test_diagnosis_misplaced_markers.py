"""Markers under each other's ids and corners that begin elsewhere are named; a wrong print or lens is neither."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from diagnosis_cases import MACHINE_TOML
from static_points import packed

from diagnosis.behind.misplaced_markers import misplaced_markers
from diagnosis.log.nominal import nominal_of
from diagnosis.log.tables import MarkerTable, Tables
from machine.effects.layout import ParameterSets, neutral_sets
from machine.effects.seen import seen_corners
from machine.poses import pose
from machine.rotations import rotation_from_rotvec
from machine.targets import Marker

LAYOUT = tuple(
    Marker(number, 0.15, "ooi", pose(np.eye(3), np.array(at)))
    for number, at in ((7, (0.3, 0.1, 0.0)), (8, (-0.3, 0.0, 0.05)), (9, (0.0, -0.25, 0.0)))
)
NOMINAL = nominal_of(MACHINE_TOML)
Change = Callable[[int, np.ndarray], tuple[int, np.ndarray]]


def as_it_is(number: int, corners: np.ndarray) -> tuple[int, np.ndarray]:
    return number, corners


def tables(change: Change = as_it_is, sets: ParameterSets | None = None, count: int = 20) -> Tables:
    """Looks at an object 1.5 m ahead, corners with a tenth of a pixel of noise, each row changed."""
    rng = np.random.default_rng(5)
    ahead = np.diag([1.0, -1.0, -1.0])
    turned = [rotation_from_rotvec(0.1 * rng.normal(size=3)) @ ahead for _ in range(count)]
    Ts = np.array([pose(R, np.array([0.0, 0.0, 1.5]) + 0.05 * rng.normal(size=3)) for R in turned])
    assert NOMINAL.camera is not None
    seen = seen_corners(neutral_sets(6) if sets is None else sets, NOMINAL.camera, LAYOUT, Ts)
    rows = []
    for k in range(count):
        for eye, pixels in enumerate((seen.left_px, seen.right_px)):
            for m, marker in enumerate(LAYOUT):
                number, corners = change(marker.marker_id, pixels[k, m] + rng.normal(0.0, 0.1, (4, 2)))
                rows.append((0.1 * k, eye, number, corners))
    stamps, eyes, ids, corners = (np.array(column) for column in zip(*rows, strict=True))
    made: Any = SimpleNamespace(markers=MarkerTable(stamps, eyes, ids, corners))
    return cast(Tables, made)


def nominal(layout: tuple[Marker, ...] = LAYOUT) -> Any:
    return SimpleNamespace(camera=NOMINAL.camera, markers=layout)


@pytest.mark.parametrize(
    ("change", "code", "told"),
    [
        (lambda i, c: ({7: 9, 9: 7}.get(i, i), c), "swapped_columns", "markers 7 and 9 are exchanged"),
        (lambda i, c: (i, np.roll(c, 1, axis=0)), "corner_order", "corners do not begin at the marker's top left"),
        (lambda i, c: (i, np.roll(c, 2, axis=0)), "corner_order", "top left one"),
    ],
)
def test_it_is_named(change: Change, code: str, told: str) -> None:
    (finding,) = misplaced_markers(tables(change), nominal())
    assert (finding.code, finding.severity) == (code, "fatal")
    assert told in finding.text


@pytest.mark.parametrize(
    "sets",
    [
        None,
        packed("marker_size_error", None, scale_frac=0.2),
        packed("focal_length_error", None, scale_frac=0.05),
        packed("lens_distortion", None, k1=0.2),
    ],
)
def test_no_fault_is_taken_for_it(sets: ParameterSets | None) -> None:
    assert not misplaced_markers(tables(sets=sets), nominal())


def test_one_marker_or_few_looks_tell_nothing() -> None:
    def wrong(number: int, corners: np.ndarray) -> tuple[int, np.ndarray]:
        return number, np.roll(corners, 1, axis=0)

    assert not misplaced_markers(tables(wrong), nominal(LAYOUT[:1]))
    assert not misplaced_markers(tables(wrong, count=4), nominal())
