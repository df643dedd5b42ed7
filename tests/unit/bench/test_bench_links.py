"""What is drawn for the bench of links, and what counts as right there."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from benchmarks.diagnosis.links import command
from benchmarks.diagnosis.links.cases import KINDS, draw
from benchmarks.diagnosis.links.run import Outcome
from longreach.cli import app


def outcome(seed: int, verdict: str, told: list[list], true: list[list]) -> Outcome:
    return Outcome(seed, KINDS[seed % len(KINDS)], {}, true, told, verdict, "", 0, 0)


def test_every_fourth_case_is_healthy_and_the_others_have_what_is_to_be_named() -> None:
    cases = [draw(seed) for seed in range(80)]
    assert [one.kind for one in cases[:4]] == list(KINDS)
    assert all(bool(one.true) is (one.kind != "healthy") for one in cases)
    assert all((("packet_loss", None) in one.true) is (one.link.loss_frac > 0.0) for one in cases)
    assert all((("transport_delay", None) in one.true) is (one.link.delay_s > 0.0) for one in cases)
    assert 0 < sum(len(one.true) == 2 for one in cases) < 15
    assert draw(7) == draw(7)


@pytest.mark.parametrize(
    ("verdict", "told", "true", "exact", "refused", "false"),
    [
        ("none", [], [], True, False, False),
        ("none", [], [["packet_loss", None]], False, False, False),
        ("effects", [["packet_loss", None]], [["packet_loss", None]], True, False, False),
        ("effects", [["valve_lag", 3]], [["valve_lag", 2]], False, False, True),
        ("effects", [["valve_lag", 2], ["packet_loss", None]], [["valve_lag", 2]], False, False, True),
        ("undecided", [["valve_lag", 3]], [["valve_lag", 3]], False, True, False),
        ("outside", [], [], False, True, False),
    ],
)
def test_only_what_is_claimed_and_true_is_exact(
    verdict: str, told: list[list], true: list[list], exact: bool, refused: bool, false: bool
) -> None:
    one = outcome(0, verdict, told, true)
    assert (one.exact, one.refused, one.false) == (exact, refused, false)


def test_a_second_run_goes_on_and_tells_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def run_case(seed: int) -> Outcome:
        asked.append(seed)
        return outcome(seed, "none", [], [])

    monkeypatch.setattr(command, "run_case", run_case)
    for n in ("3", "5"):
        done = CliRunner().invoke(app, ["bench", "links", "--n", n, "--seed", "4", "--folder", str(tmp_path)])
        assert done.exit_code == 0, done.output
    assert asked == [4, 5, 6, 7, 8]
    assert "N = 5" in done.output
