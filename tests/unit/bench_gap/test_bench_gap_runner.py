"""A campaign's cases are of one version of the code."""

import pytest

from longreach.bench_gap import code_mark
from longreach.bench_gap.runner import ROOT, Campaign, CampaignError, run_campaign

NONE = range(0)


@pytest.fixture
def asked(tmp_path):
    """A campaign whose baseline and limits are there."""
    made = Campaign("own", 7, tmp_path)
    made.machine.write_text("", encoding="utf-8")
    made.limits.write_text("{}", encoding="utf-8")
    return made


def test_it_is_resumed_by_the_same_code(asked):
    assert run_campaign(asked, NONE) == 0
    assert run_campaign(asked, NONE) == 0
    assert (asked.place / "code.txt").read_text(encoding="utf-8").strip() == code_mark.code_mark(ROOT)


def test_other_code_is_refused_and_leaves_what_is_there(asked):
    run_campaign(asked, NONE)
    (asked.place / "code.txt").write_text("0123456789abcdef\n", encoding="utf-8")
    with pytest.raises(CampaignError, match="other code"):
        run_campaign(asked, NONE)
    assert (asked.place / "code.txt").read_text(encoding="utf-8") == "0123456789abcdef\n"


def test_a_changed_number_changes_the_mark(tmp_path, monkeypatch):
    monkeypatch.setattr(code_mark, "SOURCES", ("diagnosis",))
    (tmp_path / "diagnosis").mkdir()
    file = tmp_path / "diagnosis" / "calibration.json"
    file.write_text("1", encoding="utf-8")
    before = code_mark.code_mark(tmp_path)
    file.write_text("2", encoding="utf-8")
    assert code_mark.code_mark(tmp_path) != before
