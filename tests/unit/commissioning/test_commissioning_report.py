"""The report there and back, its verdict as an exit code, and what the command asks for."""

import dataclasses
import io
import os
import socket
from pathlib import Path
from types import SimpleNamespace

import pytest
from commissioning_states import MACHINE
from rich.console import Console

from longreach.commission_command import _earlier_results, _require_free_port, _require_same_plc, chosen_steps
from longreach.commission_operator import TerminalOperator, read_answers
from server.commissioning.contracts import Figure, ReportTable, StepResult, Verdict
from server.commissioning.report import Report, exit_code, from_json, to_json, to_markdown
from server.errors import SettingsError
from server.settings import ServerSettings

RESULTS = (
    StepResult("link dry run", Verdict.PASS, "fine", (Figure("rate", 100.0, "1/s", 95.0, 105.0),), duration_s=3.0),
    StepResult(
        "stop times",
        Verdict.FAIL,
        "a | b",
        (Figure("ramp", float("nan"), "ms", at_most=20.0),),
        "look",
        ("a note",),
        (ReportTable("stops", ("move", "ms"), (("tool", "3"),)),),
    ),
)


def report(results=RESULTS, earlier=(), digest="ab"):
    settings = ServerSettings().model_dump(mode="json")
    return Report("m", "2026-01-02T03:04:05+00:00", "0.1", "HMLINK 1.1", 7, digest, True, results, earlier, settings)


def test_a_report_survives_json():
    back = from_json(to_json(report()), "x.json")
    assert back.results[0] == RESULTS[0]
    assert back.results[1].tables == RESULTS[1].tables
    assert back.results[1].verdict is Verdict.FAIL
    assert not back.results[1].figures[0].ok
    assert to_json(back) == to_json(report())


@pytest.mark.parametrize("text", ["{}", "[]", "nonsense", '{"version": 9}'])
def test_what_is_no_report_is_refused(text):
    with pytest.raises(SettingsError, match=r"x\.json"):
        from_json(text, "x.json")


def test_another_version_is_refused():
    with pytest.raises(SettingsError, match="version 2"):
        from_json(to_json(report()).replace('"version": 1', '"version": 2'), "x.json")


def test_markdown_says_what_matters():
    text = to_markdown(report())
    assert "**A simulated machine**" in text
    assert "**Not finished**" in text
    assert "**Not finished**" not in to_markdown(dataclasses.replace(report(), complete=True))
    assert "a \\| b" in text
    assert "| ramp | none | <= 20 | ms | **no** |" in text
    assert "| rate | 100 | >= 95, <= 105 | 1/s |  |" in text
    assert "plc.port = 50110" in text


def test_a_later_result_takes_the_earlier_ones_place():
    earlier = (StepResult("stop times", Verdict.PASS, "old"), StepResult("limits equal", Verdict.PASS, "same"))
    names = [(result.name, result.verdict) for result in report(earlier=earlier).all_results]
    assert names == [
        ("link dry run", Verdict.PASS),
        ("stop times", Verdict.FAIL),
        ("limits equal", Verdict.PASS),
    ]
    assert "limits equal: pass (from the earlier report)" in to_markdown(report(earlier=earlier))


@pytest.mark.parametrize(
    ("verdicts", "code"),
    [
        (["pass", "pass"], 0),
        (["pass", "fail", "skipped"], 1),
        (["pass", "skipped"], 3),
        (["inconclusive"], 3),
        (["cannot tell"], 3),
    ],
)
def test_the_exit_code_tells_the_worst(verdicts, code):
    assert exit_code([StepResult("x", Verdict(verdict), "") for verdict in verdicts]) == code


def test_figures_of_nan_are_outside_even_without_the_other_limit():
    nan = float("nan")
    assert not Figure("x", nan, "m", at_most=1.0).ok
    assert not Figure("x", nan, "m", at_least=1.0).ok
    assert Figure("x", 5.0, "m").ok


# --- the command ----------------------------------------------------------------------------------------------------


def test_steps_are_chosen_by_number_in_the_lists_order():
    assert [step.number for step in chosen_steps("4, 1")] == [1, 4]
    assert len(chosen_steps("")) == 8
    with pytest.raises(SettingsError, match="9 is not a step"):
        chosen_steps("1,9")


def test_answers_are_read_by_step_and_joint(tmp_path):
    path = tmp_path / "answers.toml"
    path.write_text('[joint_signs]\nslew = "left"\n[encoder_zeros]\nlift = 12.5\n')
    assert read_answers(path) == {"joint_signs.slew": "left", "encoder_zeros.lift": "12.5"}
    assert read_answers(None) == {}


@pytest.mark.parametrize("text", ["slew = 1", "[joint_signs]\nslew = true", "[a", "[a]\nb = [1]"])
def test_wrong_answers_files_are_refused(tmp_path, text):
    path = tmp_path / "answers.toml"
    path.write_text(text)
    with pytest.raises(SettingsError, match="answers file"):
        read_answers(path)


def test_missing_answers_file_is_refused():
    with pytest.raises(SettingsError, match="give a TOML file"):
        read_answers(Path("not/there.toml"))


def operator(answers=None, yes=True, move=False):
    return TerminalOperator(Console(file=io.StringIO()), answers or {}, yes, move)


async def test_with_yes_nobody_answers_and_nothing_may_move():
    nobody = operator({"joint_signs.slew": "left", "typo": "x"})
    assert await nobody.confirm("go on?")
    assert await nobody.ask("joint_signs.lift", "which way?") is None
    assert await nobody.ask("joint_signs.slew", "which way?") == "left"
    assert not await nobody.may_move("hiab033")
    assert await operator(move=True).may_move("hiab033")
    assert nobody.open_answers == ("typo",)


async def test_an_engineer_types_the_name_and_confirms_with_enter(monkeypatch):
    read, write = os.pipe()
    stdin = os.fdopen(read)
    monkeypatch.setattr("sys.stdin", stdin)
    os.write(write, b"hiab\nhiab033\n\nn\nleft\n")
    os.close(write)
    person = operator(yes=False)
    assert not await person.may_move("hiab033")
    assert await person.may_move("hiab033")
    assert await person.confirm("go on?")
    assert not await person.confirm("go on?")
    assert await person.ask("joint_signs.slew", "which way?") == "left"
    assert await person.ask("joint_signs.lift", "which way?") is None
    assert not await person.confirm("go on?")
    assert not await person.may_move("hiab033")
    stdin.close()


def test_a_taken_port_names_the_server():
    with socket.socket(type=socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        settings = ServerSettings.model_validate({"plc": {"local_host": "127.0.0.1", "local_port": port}})
        with pytest.raises(SettingsError, match="one controller at a time"):
            _require_free_port(settings)
    _require_free_port(settings)


def test_a_report_of_another_machine_file_is_not_gone_on_from():
    assert _earlier_results(None, MACHINE, "ab") == ()
    assert _earlier_results(report(), MACHINE, "ab") == RESULTS
    with pytest.raises(SettingsError, match="another machine file"):
        _earlier_results(report(), MACHINE, "cd")


@pytest.mark.parametrize("later", [Verdict.SKIPPED, Verdict.INCONCLUSIVE])
def test_an_earlier_failure_that_was_left_open_still_fails(later):
    failed = StepResult("joint signs", Verdict.FAIL, "tool went the wrong way")
    left_open = report(results=(StepResult("joint signs", later, "nobody looked"),), earlier=(failed,))
    assert exit_code(left_open.all_results) == 1
    mended = report(results=(StepResult("joint signs", Verdict.PASS, "seen"),), earlier=(failed,))
    assert exit_code(mended.all_results) == 0


class Link:
    """A link that has heard a PLC, or none."""

    def __init__(self, simulation=True, cfg_id=7, heard=True):
        self.latest = SimpleNamespace(simulation=simulation) if heard else None
        self.health = SimpleNamespace(cfg_id=cfg_id if heard else 0)


@pytest.mark.parametrize(
    ("link", "host", "told"),
    [
        (Link(), "127.0.0.1", None),
        (Link(simulation=False), "127.0.0.1", "a simulation was True, is False"),
        (Link(cfg_id=8), "127.0.0.1", "cfg_id was 0x00000007, is 0x00000008"),
        (Link(), "10.0.0.5", "its address was 127.0.0.1, is 10.0.0.5"),
        (Link(heard=False), "127.0.0.1", "does not answer"),
    ],
)
async def test_a_report_of_another_plc_proves_nothing_of_this_one(link, host, told, monkeypatch):
    monkeypatch.setattr("longreach.commission_command.PLC_WAIT_S", 0.0)
    earlier = dataclasses.replace(report(), cfg_id=7, simulation=True, settings={"plc": {"host": "127.0.0.1"}})
    settings = ServerSettings.model_validate({"plc": {"host": host}})
    if told is None:
        await _require_same_plc(earlier, settings, link)
        return
    with pytest.raises(SettingsError, match=told):
        await _require_same_plc(earlier, settings, link)
