"""The diagnosis on set-ups that nobody chose: other plant, other integrator, any rate, any noise, things not logged.

LONGREACH_SET_UPS: how many (34); LONGREACH_SET_UPS_SEED: the first seed (1001).
"""

import os
from pathlib import Path
from typing import Any

import pytest
from diagnosis_cases import likely
from drawn_set_ups import Named, SetUp, drawn

from diagnosis.answer import answer_json
from diagnosis.budget import budget_of
from diagnosis.reading.read import read_for_diagnosis

COUNT = int(os.environ.get("LONGREACH_SET_UPS", "34"))
FIRST = int(os.environ.get("LONGREACH_SET_UPS_SEED", "1001"))


def test_a_seed_is_a_set_up() -> None:
    some = [drawn(seed) for seed in range(170)]
    assert some[7] == drawn(7)
    assert len({one.kind for one in some}) == 17
    assert {one.without for one in some} == {"", "u_", "q_ref", "seq", "sent", "offset", "segments"}
    assert all("camera_px" in one.logged for one in some if one.kind in ("focal_length_error", "late"))


@pytest.mark.slow
@pytest.mark.timeout(120 * COUNT)
def test_what_is_named_is_there(tmp_path: Path) -> None:
    """Nothing false, nine in ten exact; what a recording cannot tell apart counts as one name."""
    exact, false = [], []
    for seed in range(FIRST, FIRST + COUNT):
        one = drawn(seed)
        found = answer_json(budget_of(read_for_diagnosis(one.write(tmp_path / str(seed)))))
        verdict, told = found["verdict"], _told(found)
        right = _right(one, found, told)
        exact.append(right)
        if not right and verdict == "effects":
            false.append((seed, one.kind, one.without, told))
        print(f"seed {seed}, {one.kind}: {'right' if right else f'{verdict} {told}'}", flush=True)
    assert false == []
    assert sum(exact) >= 0.9 * len(exact)


def _told(found: dict[str, Any]) -> Named:
    best = likely(found)
    return [(effect["name"], effect["joint"]) for effect in best]


def _right(one: SetUp, found: dict[str, Any], told: Named) -> bool:
    if one.named is None:
        return found["verdict"] in ("outside", "undecided")
    measured = "repeat" in one.logged["kinds"] and one.without != "segments"  # the noise
    allowed = {"effects"} if one.named else {"none"} if measured else {"none", "undecided"}
    if found["verdict"] not in allowed:
        return False
    classes = [{(each["name"], each["joint"]) for each in group} for group in found["indistinguishable"]]

    def same(a: tuple[str, int | None], b: tuple[str, int | None]) -> bool:
        return a == b or any({a, b} <= group for group in classes)

    return len(told) == len(one.named) and all(any(same(true, name) for name in told) for true in one.named)
