"""Keys and values of a machine file that would be misread in silence, and boards of markers."""

from dataclasses import replace
from pathlib import Path

import pytest
from diagnosis_cases import MACHINE_TOML, recording

from diagnosis.errors import DiagnosisError
from diagnosis.log.nominal import nominal_of
from diagnosis.reading.read import examine_recording
from machine.errors import MachineError
from recording.rows import MarkerCorners

PLACE = "[1, 0, 0, 0,  0, 1, 0, 0,  0, 0, 1, 0,  0, 0, 0, 1]"
BOARD = (
    '\n[[markers.board]]\nkind = "grid"\non = "ooi"\nsquares_x = 2\nsquares_y = 2\nsquare_m = 0.2\nmarker_m = 0.1\n'
    f"first_id = 30\nT_on_board = {PLACE}\n"
)


def with_board(text: str = BOARD) -> str:
    return MACHINE_TOML.replace("[plc]", f"{text}\n[plc]", 1)


def told(toml: str) -> list[tuple[str, str]]:
    return [(one.severity, one.text) for one in nominal_of(toml).findings]


def test_a_sound_file_has_no_odd_key() -> None:
    assert told(MACHINE_TOML) == []


@pytest.mark.parametrize(
    ("given", "spoilt", "severity", "text"),
    [
        ("pt1_tau_s", "pt1_tau", "problem", "[[joint]] 1, 2, 3, 4, 5, 6: key 'pt1_tau' is not known and was not read"),
        ("pt1_tau_s", "pt1_tau", "problem", "did you mean 'pt1_tau_s'?"),
        ("transport_delay_s", "transport_delay", "problem", "[plc]: key 'transport_delay' is not known"),
        ("kp_frac_per_rad", "KP", "problem", "did you mean 'kp_frac_per_rad'?"),
        ("[plc]", "[colours]\nboom = 1\n[plc]", "note", "section [colours] is not known and was not read"),
        ("[plc]", "weight = 1\n[plc]", "note", "[[markers.marker]] 4: key 'weight' is not known and was not read"),
    ],
)
def test_a_key_that_nobody_reads_is_said(given: str, spoilt: str, severity: str, text: str) -> None:
    found = told(MACHINE_TOML.replace(given, spoilt))
    assert any(one[0] == severity and text in one[1] for one in found), found
    whole = examine_recording(
        replace(recording(("steps",)), machine_toml=MACHINE_TOML.replace(given, spoilt)), Path("made")
    )
    assert whole.has_judgeable_stage
    assert "unknown_key" in {one.code for one in whole.findings}


@pytest.mark.parametrize(
    ("given", "spoilt", "text"),
    [
        ("rectified = false", 'rectified = "false"', "[camera]: rectified = 'false'; write true or false"),
        ('type = "revolute"', 'type = "linear"', "joint 1: type = 'linear'; give 'revolute' or 'prismatic'"),
        ("[plc]", f"{BOARD.replace('30', '-3')}[plc]", "markers.board 1: first_id = -3: Input should be greater"),
        ("[plc]", f"{BOARD.replace('first_id = 30', '')}[plc]", "markers.board 1: first_id: Field required"),
    ],
)
def test_a_value_of_another_kind_is_refused(given: str, spoilt: str, text: str) -> None:
    assert given in MACHINE_TOML
    with pytest.raises(DiagnosisError) as error:
        nominal_of(MACHINE_TOML.replace(given, spoilt, 1))
    assert text in str(error.value)


def test_a_type_without_geometry_is_judged_all_the_same() -> None:
    with pytest.raises(DiagnosisError, match="type = 'linear'"):
        nominal_of('[[joint]]\nname = "lift"\ntype = "linear"\n')


def test_the_markers_of_a_grid_are_markers() -> None:
    nominal = nominal_of(with_board())
    grid = [one for one in nominal.markers if one.marker_id >= 30]
    assert [one.marker_id for one in grid] == [30, 31, 32, 33]
    assert grid[0].T_on_marker[:2, 3] == pytest.approx([-0.1, 0.1])
    seen = MarkerCorners(0.1, "left", 33, 0, 0, 9, 0, 9, 9, 0, 9)
    made = recording(("steps",))
    made = replace(made, machine_toml=with_board(), rows=(*made.rows, seen))
    assert not [
        found for found in examine_recording(made, Path("made")).findings if "not in machine.toml" in found.text
    ]


@pytest.mark.parametrize(
    ("text", "told_so"),
    [
        (BOARD.replace("30", "1"), "first_id = 1: its ids 1 .. 4 repeat"),
        (BOARD + BOARD, "repeat"),
        (BOARD.replace("marker_m = 0.1", "marker_m = 0.3"), "marker_m = 0.3 exceeds"),
        (BOARD.replace("30", "5000"), "is not in DICT"),
        (f'\n[[markers.marker]]\nid = 1\nside_m = 0.1\non = "ooi"\nT_on_marker = {PLACE}\n', "repeat; every marker"),
    ],
)
def test_ids_that_repeat_or_that_no_dictionary_has_are_refused(text: str, told_so: str) -> None:
    with pytest.raises(DiagnosisError) as error:
        nominal_of(with_board(text))
    assert told_so in str(error.value)
    assert isinstance(error.value.__cause__, MachineError)


def without(field: str) -> str:
    """The file without a list that runs over several lines."""
    head, tail = MACHINE_TOML.split(f"{field} = [", 1)
    return head + tail.split("]", 1)[1]


def test_frames_that_are_not_given_are_absent() -> None:
    def absent(field: str) -> str:
        return nominal_of(without(field)).why_absent("camera")

    assert absent("T_tcp_cam_left") == "[camera] has no T_tcp_cam_left"
    assert absent("T_tcp_tool") == "[tool] has no T_tcp_tool: the markers on the tool are not used"
    assert absent("T_flange_tcp") == "[tool] has no T_flange_tcp: the tcp is taken to be the last link's frame"
