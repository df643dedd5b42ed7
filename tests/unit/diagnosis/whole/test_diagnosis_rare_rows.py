"""Rows far apart of a machine whose step, or whose reference, nobody logged: no cause is made up for it."""

from pathlib import Path
from typing import Any

from diagnosis_cases import confirmed, likely
from foreign_plant import Fault, rewritten, write

from diagnosis.answer import answer_json
from diagnosis.budget import budget_of
from diagnosis.reading.read import read_for_diagnosis

ROWS_S, FINE = 0.02, 2**20  # seconds between rows; counts of a quiet encoder
ONCE = ("steps", "workcycle", "sweep")
REPEATED = ("repeat", "repeat", "repeat", "repeat", "steps", "workcycle")


def told(place: Path) -> tuple[dict[str, Any], list[tuple[str, int | None]]]:
    """The answer, and what its best hypothesis names."""
    found = answer_json(budget_of(read_for_diagnosis(place)))
    best = likely(found)
    return found, [(one["name"], one["joint"]) for one in best]


def test_a_machines_own_step_is_no_lag_where_nothing_was_repeated(tmp_path: Path) -> None:
    """The model's own step showed at jumps as 1.6 ms of a valve's lag, by 44 nats."""
    place = write(tmp_path, Fault(), seed=725, seconds=10.0, noise=1e-5, kinds=ONCE, log_s=ROWS_S, counts=FINE)
    found, _ = told(place)
    assert (found["verdict"], confirmed(found)) == ("undecided", {}), found["why"]


def test_a_reference_that_was_sent_but_not_logged_makes_no_gain(tmp_path: Path) -> None:
    """Its steps are teeth of the command that rows do not show: they had been 0.4 % of gain on every joint."""
    place = write(tmp_path, Fault(), seed=731, seconds=10.0, kinds=REPEATED, log_s=ROWS_S, counts=FINE)
    found, named = told(rewritten(place, without=("q_ref",)))
    assert (found["verdict"], named) == ("none", []), found["why"]


def test_a_delay_between_two_sizes_of_its_range_is_found(tmp_path: Path) -> None:
    """Every other datagram is in a row: 8 to 16 ms leave nothing, 6 ms as much as none, and 17.5 ms more."""
    fault = Fault(delay_s=0.0125)
    place = write(tmp_path, fault, seed=755, seconds=10.0, noise=6e-5, log_s=ROWS_S, counts=FINE)
    found, named = told(place)
    assert (found["verdict"], named) == ("effects", [("transport_delay", None)]), found["why"]
    delay = likely(found)[0]["parameters"]["delay_s"]
    assert delay["low"] < fault.delay_s < delay["high"]
