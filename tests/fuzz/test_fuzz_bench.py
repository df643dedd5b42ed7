"""`longreach bench fuzz`: chunks are saved and gone on with, and the report says what was reached."""

import json
from pathlib import Path

import pytest
from rich.console import Console

from benchmarks.link.fuzz import command as bench_fuzz
from benchmarks.link.fuzz.command import Lane, run_lane
from benchmarks.link.fuzz.counts import FuzzCounts
from benchmarks.link.fuzz.verdict import Violation


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_fuzz, "_CHUNK", 100)


def numbers(lane: Lane) -> list[str]:
    """Everything saved but the time it took."""
    texts = []
    for file in sorted(lane.folder.glob("*.json")):
        data = json.loads(file.read_text(encoding="utf-8"))
        del data["counts"]["seconds"]
        texts.append(f"{file.name} {json.dumps(data)}")
    return texts


def test_an_interrupted_lane_goes_on_where_it_was(tmp_path: Path) -> None:
    lane = Lane("client", 0, 1, tmp_path)
    run_lane(lane, 250, "hiab033")
    whole = numbers(lane)
    assert [counts.n for counts, _ in lane.saved()] == [100, 100, 50]
    lane.chunk_file(2).unlink()
    lane.chunk_file(2).with_suffix(".part").write_text("{", encoding="utf-8")  # killed while saving
    run_lane(lane, 250, "hiab033")
    assert numbers(lane) == whole
    run_lane(lane, 300, "hiab033")
    assert sum(counts.n for counts, _ in lane.saved()) == 300
    assert numbers(lane)[:3] == whole


def test_the_report_states_what_was_reached() -> None:
    counts = FuzzCounts("plc", n=1234, sealed=700, taken=200, silent=34, refused=1000, seconds=2.0)
    counts.blame(Violation("plc", "taken", "RUN", b"\x01\x02"))
    console = Console(width=120, record=True, quiet=False, file=None, force_terminal=False)
    with console.capture() as captured:
        console.print(bench_fuzz.report([counts, FuzzCounts("client")]))
    text = captured.get()
    for expected in ("1,234", "700 (57%)", "200 / 34 / 1,000", "617"):
        assert expected in text
    assert counts.evidence == ["plc: taken | RUN | 0102"]
