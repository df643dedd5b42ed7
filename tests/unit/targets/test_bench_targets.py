"""The targets bench counts what it says, and finds every fault on one wall."""

from target_scenes import SETTINGS, machine

from benchmarks.targets.command import fault_rows, patch_rows, point_rows
from benchmarks.targets.faults import KINDS, FaultCase, fault_cases
from benchmarks.targets.patches import PatchCase
from benchmarks.targets.rendered import PointCase

NAN = float("nan")


def patch(chi2: float, normal_deg: float) -> PatchCase:
    return PatchCase(1, 1.0, 0.8, 5.0, "ok", 0.1, 0.2, normal_deg, 0.8, chi2, chi2, 60.0)


def test_patches_are_counted_with_their_refusals():
    refused = PatchCase(1, 1.0, 2.5, 5.0, "too_far", *[NAN] * 7)
    rows = {name: share for name, share, _ in patch_rows([patch(1.0, 0.5), patch(9.0, 2.5), refused])}
    assert rows["measured (refused: too_far 1)"] == "2 of 3 (66.7 %)"
    assert rows["normal within 2 deg"] == "1 of 2 (50.0 %)"
    assert rows["95 % ellipsoid holds the position"] == "1 of 2 (50.0 %)"


def test_a_served_wrong_pose_is_counted_and_a_faultless_look_must_be_served():
    cases = [FaultCase(1, "glare", False, True, ""), FaultCase(1, "none", False, False, "")]
    rows = {name: share for name, share, _ in fault_rows(cases)}
    assert rows["glare: found"].startswith("0 of 1")
    assert rows["without a fault: served"].startswith("1 of 1")
    assert rows["served and more than 5 mm off"].startswith("1 of 2")


def test_a_job_that_is_sure_and_wrong_is_counted():
    wrong = PointCase(1, "done", "", 0, 0, 1.0, 0.8, ((1.0, 6.0, 0.0),), ((0.0, 0.0, 0.0),), (0.5,), True, 80.0)
    rows = {name: share for name, share, _ in point_rows([wrong])}
    assert rows["truly inside 5 mm on each axis after one move, of those"].startswith("0 of 1")
    assert rows["reached by its own word and truly outside"].startswith("1 of 1")


def test_on_one_wall_every_fault_is_found_and_the_faultless_look_is_served():
    cases = {case.kind: case for case in fault_cases(machine(), 5, SETTINGS)}
    assert set(cases) == set(KINDS)
    assert not cases["none"].found, cases["none"].reason
    assert [kind for kind in KINDS if kind != "none" and not cases[kind].found] == []
