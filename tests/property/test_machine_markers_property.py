"""Whatever stands in the marker section: a machine that keeps the rules, or an error that names field and remedy."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from machine.boards import board_marker_ids, board_markers, inner_corners
from machine.description import parse_machine_toml
from machine.errors import MachineFileError
from machine.marker_sections import DICTIONARY_PATTERN, dictionary_size

TEXT = (Path(__file__).parents[2] / "machine" / "machines" / "hiab033.toml").read_text(encoding="utf-8")
HEAD, TAIL = TEXT[: TEXT.index("[markers]")], TEXT[TEXT.index("[plc]") :]
EYE = [1.0, 0, 0, 0, 0, 1.0, 0, 0, 0, 0, 1.0, 0, 0, 0, 0, 1.0]
SIZE = 50

MARKER = {"id": 10, "side_m": 0.1, "on": "tool", "T_on_marker": EYE}
BOARD = {
    "kind": "charuco",
    "on": "ooi",
    "squares_x": 5,
    "squares_y": 4,
    "square_m": 0.04,
    "marker_m": 0.03,
    "first_id": 20,
    "legacy_pattern": False,
    "T_on_board": EYE,
}


def toml_value(value):
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return '"' + "".join(c if c.isalnum() or c in "_- " else "_" for c in value) + '"'
    if isinstance(value, list):
        return "[" + ", ".join(toml_value(float(one)) for one in value) + "]"
    return repr(value)


def text_of(markers, boards, dictionary="DICT_4X4_50"):
    parts = [HEAD, f'[markers]\ndictionary = "{dictionary}"\n']
    for name, sections in (("marker", markers), ("board", boards)):
        for section in sections:
            parts.append(f"[[markers.{name}]]\n" + "".join(f"{k} = {toml_value(v)}\n" for k, v in section.items()))
    return "\n".join([*parts, TAIL])


def outside(low, high):
    """Finite numbers strictly outside an interval."""
    below = st.floats(-1e6, low, exclude_max=True, allow_nan=False)
    above = st.floats(high, 1e6, exclude_min=True, allow_nan=False)
    return st.one_of(below, above)


POSITIVE_TO_2 = st.one_of(st.floats(-1e6, 0.0), st.floats(2.0, 1e6, exclude_min=True))
BAD_MARKER = st.one_of(
    st.tuples(st.just("side_m"), POSITIVE_TO_2, st.just("[m]; measure")),
    st.tuples(st.just("id"), st.integers(-(10**6), -1), st.just("; give the number")),
    st.tuples(st.just("id"), st.integers(SIZE, 10**6), st.just("ends at 49; give the number")),
    st.tuples(st.just("on"), st.text(max_size=8).filter(lambda t: t not in ("tool", "ooi")), st.just("; state what")),
    st.tuples(st.just("T_on_marker"), st.lists(st.floats(-1, 1), max_size=15), st.just("; give 16 numbers")),
)
BAD_BOARD = st.one_of(
    st.tuples(st.just("square_m"), POSITIVE_TO_2, st.just("[m]; measure ten")),
    st.tuples(st.just("marker_m"), POSITIVE_TO_2, st.just("[m]; measure the black")),
    st.tuples(st.just("marker_m"), st.floats(0.0361, 2.0), st.just("[m]; leave white")),
    st.tuples(st.just("squares_x"), st.integers(-1000, 0), st.just("; count the squares")),
    st.tuples(st.just("squares_x"), st.integers(1, 2), st.just("; a charuco board needs four")),
    st.tuples(st.just("squares_y"), st.integers(101, 10**6), st.just("; count the squares")),
    st.tuples(st.just("first_id"), st.integers(-(10**6), -1), st.just("; give the lowest marker id")),
    st.tuples(st.just("first_id"), st.integers(41, 10**6), st.just("ends at 49; give a lower")),
    st.tuples(st.just("first_id"), st.integers(1, 10), st.just("; every marker needs an id of its own")),
    st.tuples(
        st.just("kind"), st.text(max_size=8).filter(lambda t: t not in ("charuco", "grid")), st.just("; charuco is")
    ),
)


@settings(max_examples=150, deadline=None)
@given(bad=BAD_MARKER)
def test_a_marker_value_out_of_range_names_field_value_limit_and_remedy(bad):
    field, value, remedy = bad
    with pytest.raises(MachineFileError) as caught:
        parse_machine_toml(text_of([MARKER, MARKER | {"id": 1, "on": "ooi", field: value}], []))
    message = str(caught.value)
    assert field in message
    assert remedy in message
    if not isinstance(value, (str, list)):
        assert repr(value) in message
    assert len(message) < 500


@settings(max_examples=150, deadline=None)
@given(bad=BAD_BOARD)
def test_a_board_value_out_of_range_names_field_value_limit_and_remedy(bad):
    field, value, remedy = bad
    with pytest.raises(MachineFileError) as caught:
        parse_machine_toml(text_of([MARKER], [BOARD | {field: value}]))
    message = str(caught.value)
    assert f"markers.board.0.{field}" in message
    assert remedy in message
    if not isinstance(value, str):
        assert repr(value) in message


@settings(max_examples=100, deadline=None)
@given(T=st.lists(st.floats(-30, 30, allow_nan=False), min_size=16, max_size=16))
def test_sixteen_numbers_that_are_no_pose_are_refused(T):
    matrix = np.array(T).reshape(4, 4)
    rotation = matrix[:3, :3]
    good = np.abs(rotation @ rotation.T - np.eye(3)).max() <= 1e-6 and np.allclose(matrix[3], [0, 0, 0, 1])
    if good and np.linalg.det(rotation) > 0:
        return
    with pytest.raises(MachineFileError, match="T_on_marker is not a pose"):
        parse_machine_toml(text_of([MARKER, MARKER | {"id": 1, "on": "ooi", "T_on_marker": T}], []))


@settings(max_examples=100, deadline=None)
@given(
    kind=st.sampled_from(["charuco", "grid"]),
    squares=st.tuples(st.integers(1, 9), st.integers(1, 9)),
    sizes=st.tuples(st.floats(1e-3, 2.0), st.floats(0.05, 1.0)),
    first_id=st.integers(0, 60),
    legacy=st.booleans(),
)
def test_any_board_is_read_or_refused_and_what_is_read_keeps_the_rules(kind, squares, sizes, first_id, legacy):
    square_m, share = sizes
    section = BOARD | {
        "kind": kind,
        "squares_x": squares[0],
        "squares_y": squares[1],
        "square_m": square_m,
        "marker_m": square_m * share,
        "first_id": first_id,
        "legacy_pattern": legacy,
    }
    text = text_of([MARKER], [section])
    try:
        machine = parse_machine_toml(text)
    except MachineFileError:
        with pytest.raises(MachineFileError, match=r"markers\.board"):
            parse_machine_toml(text)
        return
    (board,) = machine.boards
    ids = board_marker_ids(board)
    assert 10 not in ids
    assert 0 <= ids[0] <= ids[-1] < SIZE
    half = 0.5 * board.square_m * np.array([board.squares_x, board.squares_y])
    for marker in board_markers(board):
        assert np.all(np.abs(marker.T_on_marker[:2, 3]) + 0.5 * marker.side_m < half)
    if kind == "charuco":
        assert len(ids) == squares[0] * squares[1] // 2
        assert np.all(np.abs(inner_corners(board)[:, :2]) <= half - 0.9999 * board.square_m)


@given(name=st.text(max_size=40))
def test_any_other_dictionary_name_is_refused(name):
    clean = "".join(c for c in name if c.isalnum() or c == "_")
    assume(re.fullmatch(DICTIONARY_PATTERN, clean) is None)
    text = text_of([MARKER, MARKER | {"id": 1, "on": "ooi"}], [], clean)
    with pytest.raises(MachineFileError, match=r"markers\.dictionary.*; give a name of OpenCV"):
        parse_machine_toml(text)


@given(name=st.from_regex(r"DICT_(APRILTAG_[0-9]{2}h[0-9]{1,2}|ARUCO_[A-Z]{1,9})", fullmatch=True))
def test_a_family_that_nobody_knows_yet_is_left_to_the_search(name):
    machine = parse_machine_toml(text_of([MARKER, MARKER | {"id": 1, "on": "ooi"}], [], name))
    assert machine.dictionary == name
    assert dictionary_size(name) is None or name.upper() in ("DICT_APRILTAG_16H5",) or dictionary_size(name) > 10
