"""Where q_ref was not logged, the number of the datagram tells what the PLC had."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnosis_cases import likely
from foreign_plant import Fault, rewritten, write

from diagnosis.answer import answer_json
from diagnosis.budget import budget_of
from diagnosis.datagrams.ref_by_number import with_reference
from diagnosis.log.tables import Tables
from diagnosis.reading.read import read_for_diagnosis

KINDS = ("repeat", "repeat", "repeat", "steps", "workcycle")


@pytest.fixture(scope="module")
def logged(tmp_path_factory: pytest.TempPathFactory) -> Tables:
    place = tmp_path_factory.mktemp("numbers") / "run"
    write(place, Fault(), seed=5, seconds=4.0, kinds=KINDS)
    tables = read_for_diagnosis(place).tables
    assert tables is not None
    return tables


def unlogged(tables: Tables, **changed: Any) -> Tables:
    assert tables.plc is not None
    return replace(tables, plc=replace(tables.plc, ref=None, **changed))


def told(place: Path, fault: Fault) -> tuple[dict[str, Any], list[tuple[str, int | None]]]:
    write(place, fault, seed=5, seconds=8.0, kinds=KINDS)
    found = answer_json(budget_of(read_for_diagnosis(rewritten(place, without=("q_ref",)))))
    best = likely(found)
    return found, [(one["name"], one["joint"]) for one in best]


def test_it_is_what_the_plc_logged(logged: Tables) -> None:
    found, (finding,) = with_reference(unlogged(logged))
    assert finding.code == "no_reference"
    assert found.plc is not None
    assert found.plc.ref is not None
    assert not found.plc.ref_logged
    seen = np.isfinite(found.plc.ref).all(axis=1)
    assert seen.mean() > 0.99
    assert logged.plc is not None
    assert logged.plc.ref is not None
    assert found.plc.ref[seen] == pytest.approx(logged.plc.ref[seen], abs=1e-9)


def test_what_was_logged_stays(logged: Tables) -> None:
    assert with_reference(logged) == (logged, [])


def test_without_numbers_or_with_some_that_begin_again_nothing_is_guessed(logged: Tables) -> None:
    assert logged.plc is not None
    assert logged.sent is not None
    none = unlogged(logged, seq=np.full(len(logged.plc.t_s), -1))
    assert with_reference(none) == (none, [])
    half = len(logged.sent.seq) // 2
    again = replace(unlogged(logged), sent=replace(logged.sent, seq=logged.sent.seq % half))
    assert with_reference(again) == (again, [])


def test_a_log_of_sent_datagrams_with_holes_tells_nothing(logged: Tables) -> None:
    assert logged.sent is not None
    kept = np.arange(len(logged.sent.seq)) % 20 != 0
    sent = replace(logged.sent, t_s=logged.sent.t_s[kept], seq=logged.sent.seq[kept], q=logged.sent.q[kept])
    holed = replace(unlogged(logged), sent=sent)
    assert with_reference(holed) == (holed, [])


def test_rows_before_the_first_datagram_and_behind_the_last_stay_unknown(logged: Tables) -> None:
    assert logged.sent is not None
    kept = slice(200, -200)
    sent = replace(logged.sent, t_s=logged.sent.t_s[kept], seq=logged.sent.seq[kept], q=logged.sent.q[kept])
    found, _ = with_reference(replace(unlogged(logged), sent=sent))
    assert found.plc is not None
    assert found.plc.ref is not None
    assert np.isnan(found.plc.ref[[0, -1]]).all()
    assert np.isfinite(found.plc.ref[len(found.plc.ref) // 2]).all()


def test_a_controllers_gain_is_found_by_it_and_a_healthy_boom_is_healthy(tmp_path: Path) -> None:
    found, named = told(tmp_path / "gain", Fault(kp=(0.0, 0.06)))
    assert (found["verdict"], named) == ("effects", [("controller_gain_error", 2)])
    assert ["link", "controller"] in [one["stages"] for one in found["merged_stages"]]
    found, named = told(tmp_path / "sound", Fault())
    assert (found["verdict"], named) == ("none", [])


def test_what_the_plc_makes_of_the_numbers_is_named_by_nobody(tmp_path: Path) -> None:
    found, named = told(tmp_path / "rounded", Fault(quantum=0.002))
    assert found["verdict"] == "outside"
    assert named == []
    assert all(one["name"] != "reference_quantisation" for one in found["detection_limits"])
