"""Many recordings: the same answers over every executor, resumed, and read together."""

import json
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import pytest
from foreign_plant import Fault, write
from typer.testing import CliRunner

from diagnosis.fleet.case import diagnose_case
from diagnosis.fleet.page import fleet_page
from diagnosis.fleet.run import _name, diagnose_all, recordings_below
from diagnosis.fleet.summary import summary_of
from longreach.cli import app


class NoWork(Executor):
    """An executor that must not be asked."""

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        raise AssertionError(f"asked to compute {args}")


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fleet")
    write(folder / "a", Fault(), static=9, kinds=())
    write(folder / "b", Fault(sag_rad_nm=2e-6), static=12, kinds=())
    write(folder / "broken", Fault(), static=9, kinds=())
    (folder / "broken" / "machine.toml").write_text("[machine\n")
    return folder


def test_processes_and_dask_give_what_one_process_gives(recordings: Path, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    paths = recordings_below(recordings)
    assert [one.name for one in paths] == ["a", "b", "broken"]
    here = [diagnose_case(str(path)) for path in paths]
    assert [one["status"] for one in here] == ["diagnosed", "diagnosed", "unusable"]
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        processes = diagnose_all(paths, tmp_path / "processes", pool, "1")
    cluster = distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None)
    with cluster, distributed.Client(cluster) as client:
        dask = diagnose_all(paths, tmp_path / "dask", client.get_executor(pure=False), "1")
    assert json.dumps(processes) == json.dumps(here)
    assert json.dumps(dask) == json.dumps(here)


def test_a_second_run_computes_only_what_changed(recordings: Path, tmp_path: Path) -> None:
    paths = recordings_below(recordings)[:1]
    with ThreadPoolExecutor(1) as pool:
        first = diagnose_all(paths, tmp_path, pool, "1")
    assert diagnose_all(paths, tmp_path, NoWork(), "1") == first
    with pytest.raises(AssertionError, match="asked to compute"):
        diagnose_all(paths, tmp_path, NoWork(), "2")


def answer_with(recording: str, day: int, size: float | None, serial: str = "7", limit: float = 1e-3) -> dict[str, Any]:
    parameters = {"width_rad": {"value": size, "unit": "rad", "low": (size or 0) - 1e-4, "high": (size or 0) + 1e-4}}
    effects = (
        [] if size is None else [{"name": "backlash", "joint": 2, "status": "confirmed", "parameters": parameters}]
    )
    return {
        "recording": recording,
        "machine": "hiab033",
        "serial": serial,
        "folder": "yard",
        "started_utc": f"2026-03-{day:02d}T08:00:00Z",
        "status": "diagnosed",
        "findings": [],
        "answer": {
            "verdict": "none" if size is None else "effects",
            "budget": {"effects": effects},
            "indistinguishable": [],
            "detection_limits": [{"name": "backlash", "joint": 2, "parameter": "width_rad", "size": limit}],
        },
    }


def test_a_play_that_grows_is_a_drift_and_one_that_stays_is_none() -> None:
    grows = [answer_with(f"g{day}", day, 2e-3 + 2e-4 * day) for day in (1, 2, 3, 4)]
    stays = [answer_with(f"s{day}", day, 3e-3 + 3e-5 * (-1) ** day, "8") for day in (1, 2, 3, 4)]
    drifts = {drift.machine: drift for drift in summary_of(grows + stays).effect_drifts}
    assert drifts["hiab033 7"].is_drifting
    assert abs(drifts["hiab033 7"].per_day - 2e-4) < 1e-6
    assert not drifts["hiab033 8"].is_drifting


def test_a_machine_is_without_an_effect_only_if_it_would_have_been_seen() -> None:
    results = [
        answer_with("a", 1, 3e-3, "1"),
        answer_with("b", 1, 2e-3, "2"),
        answer_with("c", 1, None, "3"),
        answer_with("d", 1, None, "4", limit=0.5),
    ]
    shared = summary_of(results).shared_effects
    assert [(one.name, one.joint) for one in shared] == [("backlash", 2)]
    assert shared[0].machines_with == ("hiab033 1", "hiab033 2")
    assert shared[0].machines_without == ("hiab033 3",)
    text = fleet_page(summary_of([*results, {"status": "failed", "reason": "<b>", "recording": "x"}]), "mine")
    assert "<b>" not in text
    assert "backlash" in text


def test_a_machine_that_names_an_equal_is_not_without_the_effect() -> None:
    """One cause on both machines, which of the two equals comes first is chance: neither denies it."""
    pair = [{"name": "backlash", "joint": 2}, {"name": "encoder_scale", "joint": 2}]
    one, other = answer_with("a", 1, 3e-3, "1"), answer_with("b", 1, 3e-3, "2")
    other["answer"]["budget"]["effects"][0]["name"] = "encoder_scale"
    for told in (one, other):
        told["answer"]["indistinguishable"] = [pair]
        told["answer"]["detection_limits"].append({"name": "encoder_scale", "joint": 2, "size": 1e-3})
    shared = summary_of([one, other]).shared_effects
    assert [each.machines_without for each in shared] == [(), ()]


def test_cranes_of_one_kind_without_a_serial_are_one_machine_a_folder_and_it_is_told() -> None:
    results = [answer_with(f"r{k}", k, 2e-3 * k, "") for k in (1, 2, 3)]
    for one, place in zip(results, ("north", "south", "east"), strict=True):
        one["folder"] = place
    fleet = summary_of(results)
    assert fleet.machines == ("hiab033 in east", "hiab033 in north", "hiab033 in south")
    assert not fleet.effect_drifts
    assert "3 state no serial" in fleet_page(fleet, "mine")
    assert "no serial" not in fleet_page(summary_of([answer_with("a", 1, None)]), "mine")


def test_whose_it_is_says_its_own_file_whatever_it_is_judged_by(recordings: Path, tmp_path: Path) -> None:
    whole = recordings / "a" / "machine.toml"
    usual = tmp_path / "usual.toml"
    usual.write_text(whole.read_text(encoding="utf-8").replace("[machine]", '[machine]\nserial = "U"', 1))
    assert diagnose_case(str(recordings / "a"), str(usual))["serial"] == ""
    assert diagnose_case(str(recordings / "a"))["folder"] == recordings.name


def test_one_more_recording_renames_no_answer_and_none_is_lost(tmp_path: Path) -> None:
    places = ["p/a.mcap", "q/y-a-2.mcap", "y/a.mcap", "x/day", "y/day"]
    names = [_name(tmp_path / one, tmp_path) for one in places]
    assert len(set(names)) == len(places)
    (tmp_path / "elsewhere").mkdir()
    for one in ("crane-1", "crane-2"):
        (tmp_path / one).mkdir()
        (tmp_path / one / "day.mcap").write_bytes(b"no recording")
    with ThreadPoolExecutor(1) as pool:
        told = diagnose_all(recordings_below(tmp_path), tmp_path / "elsewhere", pool, "1", base=tmp_path)
    assert [one["recording"] for one in told] == ["crane-1/day.mcap", "crane-2/day.mcap"]


def test_the_command_says_what_is_missing(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["diagnose-fleet", str(tmp_path)])
    assert done.exit_code == 2
    assert "no recording below it" in done.output
    (tmp_path / "file").write_text("")
    done = CliRunner().invoke(app, ["diagnose-fleet", str(tmp_path), "--out", str(tmp_path / "file")])
    assert done.exit_code == 2
    assert "name a folder" in " ".join(done.output.split())


@pytest.mark.parametrize("content", [None, b"[machine]\nname = '\xe4'\n"])
def test_a_machine_file_that_cannot_be_read_is_told_at_once(
    recordings: Path, tmp_path: Path, content: bytes | None
) -> None:
    given = tmp_path / "nope.toml"
    if content is not None:
        given.write_bytes(content)
    done = CliRunner().invoke(app, ["diagnose-fleet", str(recordings), "--machine", str(given), "--out", str(tmp_path)])
    assert done.exit_code == 2
    assert f"machine file {given}" in " ".join(done.output.split())


def test_a_broken_link_does_not_end_the_fleet(tmp_path: Path) -> None:
    (tmp_path / "gone.mcap").symlink_to(tmp_path / "nowhere")
    with ThreadPoolExecutor(1) as pool:
        (found,) = diagnose_all(recordings_below(tmp_path), tmp_path / "answers", pool, "1")
    assert found["status"] == "unusable"
    assert "No such file" in found["findings"][0]["text"]
