"""A campaign's cases are of one version of the code."""

import pytest

from benchmarks.diagnosis.gap.packed import read_packed, write_packed
from benchmarks.diagnosis.gap.runner import CASES, ROOT, Campaign, CampaignError, pack, run_campaign, scores
from longreach.diagnose_fleet_command import code_mark

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
    assert (asked.place / "code.txt").read_text(encoding="utf-8").strip() == code_mark(ROOT, CASES)


def test_other_code_is_refused_and_leaves_what_is_there(asked):
    run_campaign(asked, NONE)
    (asked.place / "code.txt").write_text("0123456789abcdef\n", encoding="utf-8")
    with pytest.raises(CampaignError, match="other code"):
        run_campaign(asked, NONE)
    assert (asked.place / "code.txt").read_text(encoding="utf-8") == "0123456789abcdef\n"


def test_a_changed_number_changes_the_mark(tmp_path):
    (tmp_path / "diagnosis").mkdir()
    file = tmp_path / "diagnosis" / "calibration.json"
    file.write_text("1", encoding="utf-8")
    before = code_mark(tmp_path, ("diagnosis",))
    file.write_text("2", encoding="utf-8")
    assert code_mark(tmp_path, ("diagnosis",)) != before


def test_packed_scores_are_told_beside_those_of_the_folder_and_not_run_again(asked):
    mark = code_mark(ROOT, CASES)
    write_packed(asked.packed, mark, [{"number": 1, "exact": False}, {"number": 0, "exact": True}])
    assert run_campaign(asked, range(2)) == 0  # nothing is left to do
    here = asked.place / "case00002"
    here.mkdir()
    (here / "score.json").write_text('{"number": 2, "exact": true}', encoding="utf-8")
    assert [one["exact"] for one in scores(asked, range(5))] == [True, False, True]
    bytes_before = pack(asked, range(5)).read_bytes()
    assert sorted(read_packed(asked.packed).scores) == [0, 1, 2]
    assert pack(asked, range(5)).read_bytes() == bytes_before


def test_packed_scores_of_other_code_are_refused(asked):
    write_packed(asked.packed, "0123456789abcdef", [{"number": 0}])
    with pytest.raises(CampaignError, match="other code"):
        run_campaign(asked, range(3))


@pytest.mark.parametrize("spoilt", [b"", b"no gzip", None])
def test_packed_scores_that_cannot_be_read_are_told(asked, spoilt):
    write_packed(asked.packed, "0123456789abcdef", [{"number": 0}])
    asked.packed.write_bytes(asked.packed.read_bytes()[:-12] if spoilt is None else spoilt)
    with pytest.raises(CampaignError, match="no packed scores"):
        scores(asked, range(3))


def test_nothing_is_packed_where_nothing_is_on_file(asked):
    with pytest.raises(CampaignError, match="run the campaign first"):
        pack(asked, range(3))
