"""What cannot work is refused before the work, with the remedy, and without a traceback."""

import errno
import socket
from pathlib import Path

import pytest
from typer.testing import CliRunner

from longreach import processes
from longreach.cli import app
from longreach.fleet_client import JobClient, JobRefusedError
from longreach.processes import Address, require_bindable
from recording.machine_files import file_of_machine
from server.errors import SettingsError


def said(arguments: list[str], code: int) -> str:
    """What a command says to wrong arguments, in one line."""
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == code, done.output
    return " ".join(done.output.split())


@pytest.mark.parametrize("option", ["--html", "--json", "--machine-out", "--out"])
def test_a_file_that_could_not_be_written_in_the_end(tmp_path: Path, option: str) -> None:
    nowhere = tmp_path / "none" / "file"
    told = said(["diagnose", str(tmp_path), option, str(nowhere)], 2)
    assert f"folder {nowhere.parent} does not exist; make it" in told.replace("- ", "-")
    assert "is a folder; name a file in it" in said(["diagnose", str(tmp_path), option, str(tmp_path)], 2)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--fit-baseline", "--json", "FILE"], "--json has no effect with --fit-baseline"),
        (["--fit-baseline", "--html", "FILE"], "--html has no effect with --fit-baseline"),
        (["--fit-baseline", "--machine-out", "FILE"], "--machine-out has no effect with --fit-baseline"),
        (["--fit-baseline", "--without", "no such"], "--without has no effect with --fit-baseline"),
        (["--out", "FILE"], "--out is where --fit-baseline writes; give it as well"),
    ],
)
def test_an_option_that_would_do_nothing_is_refused(tmp_path: Path, options: list[str], told: str) -> None:
    file = str(tmp_path / "file")
    arguments = [file if one == "FILE" else one for one in options]
    out = ["--out", str(tmp_path / "out.toml")] if "--fit-baseline" in options else []
    assert told in said(["diagnose", str(tmp_path), *arguments, *out], 2)


def test_an_answer_of_an_earlier_run_is_not_left_for_this_ones(tmp_path: Path) -> None:
    answer, page = tmp_path / "answer.json", tmp_path / "page.html"
    answer.write_text("of an earlier run", encoding="utf-8")
    told = said(["diagnose", str(tmp_path / "none"), "--json", str(answer), "--html", str(page)], 2)
    assert "answer.json is not written; the one of an earlier run is answer.json.earlier now" in told
    assert "page.html" not in told
    assert told.endswith("No such file or directory")  # the last line is why: the server shows it
    assert not answer.exists()
    assert (tmp_path / "answer.json.earlier").read_text(encoding="utf-8") == "of an earlier run"
    twice = said(["diagnose", str(tmp_path / "none"), str(tmp_path / "none"), "--json", str(answer)], 2)
    assert "is given twice" in twice


def test_a_folder_of_recordings_is_no_recording(tmp_path: Path) -> None:
    (tmp_path / "20260131T101500-look.mcap").write_bytes(b"")
    told = said(["diagnose", str(tmp_path)], 2)
    assert "is not a recording but holds 1: name one of them" in told
    assert "20260131T101500-look.mcap" in told


@pytest.mark.parametrize(
    ("command", "kind", "told"),
    [
        (
            ["demo", "--no-browser", "--port", "PORT"],
            "tcp",
            "port PORT is taken by another program; give another one by ",
        ),
        (["serve", "--port", "PORT"], "tcp", "port PORT is taken by another program; give another one by --port"),
        (
            ["serve", "--port", "0", "--plc-local-port", "PORT"],
            "udp",
            "udp port PORT is taken by another program, perhaps",
        ),
        (
            ["serve", "--port", "0", "--settings", "FILE"],
            "tcp",
            "port PORT is taken by another program; give another one",
        ),
        (["serve", "--port", "0", "--settings", "LOCAL"], "udp", "'198.51.100.7' is not an address of this computer"),
        (["serve", "--host", "198.51.100.7"], "tcp", "'198.51.100.7' is not an address of this computer"),
        (
            ["serve", "--host", "no.such.host.invalid"],
            "tcp",
            "'no.such.host.invalid' is not an address of this computer",
        ),
        (
            ["sim", "--camera-port", "PORT"],
            "tcp",
            "port PORT is taken by another program; give another one by --camera-",
        ),
        (
            ["sim", "--plc-port", "PORT"],
            "udp",
            "udp port PORT is taken by another program; give another one by --plc-po",
        ),
        (["sim", "--plc-host", "198.51.100.7"], "udp", "'198.51.100.7' is not an address of this computer"),
        (["commission", "--plc-local-port", "PORT"], "udp", "one controller at a time"),
    ],
)
def test_an_address_that_nothing_can_listen_on_is_told_before_anything_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: list[str], kind: str, told: str
) -> None:
    """198.51.100.7 is of a net for documentation: no computer has it."""
    monkeypatch.setattr("server.app.serve", lambda *_: pytest.fail("it starts"))
    monkeypatch.setattr("sim_plc.process.run_sim", lambda *_: pytest.fail("it starts"))
    monkeypatch.chdir(tmp_path)
    kinds = {"tcp": socket.SOCK_STREAM, "udp": socket.SOCK_DGRAM}
    with socket.socket(socket.AF_INET, kinds[kind]) as other:
        other.bind(("127.0.0.1", 0))
        if kind == "tcp":
            other.listen()
        port = str(other.getsockname()[1])
        (tmp_path / "FILE").write_text(f"[opcua]\nenabled = true\nport = {port}\n")
        (tmp_path / "LOCAL").write_text('[plc]\nlocal_host = "198.51.100.7"\n')
        done = CliRunner().invoke(app, [port if one == "PORT" else one for one in command])
    text = str(done.exception) if isinstance(done.exception, SettingsError) else " ".join(done.output.split())
    assert told.replace("PORT", port) in text
    assert isinstance(done.exception, SettingsError) or done.exit_code == 2
    assert "panel at" not in done.output


def test_an_address_that_is_not_there_yet_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    up, told = iter([False, False, True]), []

    def try_it(_address: Address) -> None:
        if not next(up):
            raise OSError(errno.EADDRNOTAVAIL, "Cannot assign requested address")

    monkeypatch.setattr(Address, "try_it", try_it)
    monkeypatch.setattr(processes, "BIND_RETRY_DELAY_S", 0.0)
    require_bindable((Address("192.0.2.1", 1, "--host", "--port"),), 60.0, told.append)
    assert told == ["'192.0.2.1' is not an address of this computer yet; waiting for it, 60 s at most"]
    monkeypatch.undo()
    with socket.create_server(("127.0.0.1", 0)) as other:
        taken = Address("127.0.0.1", other.getsockname()[1], "--host", "--port")
        with pytest.raises(SettingsError, match="is taken by another program"):
            require_bindable((taken,), 3600.0)  # which waiting does not make free


def test_a_preset_that_does_not_exist_is_told_before_anything_is_announced() -> None:
    assert "preset 'foo' does not exist; choose one of ideal, realistic, paper" in said(["demo", "--preset", "foo"], 2)
    simulated = CliRunner().invoke(app, ["sim", "--preset", "foo"])
    assert isinstance(simulated.exception, SettingsError)
    assert simulated.output == ""


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--port", "80800"], "command line: http.port = 80800"),
        (["--camera-url", "nonsense"], "command line: camera"),
    ],
)
def test_settings_of_the_command_line_are_judged_as_those_of_a_file(arguments: list[str], told: str) -> None:
    served = CliRunner().invoke(app, ["serve", *arguments])
    assert isinstance(served.exception, SettingsError), served.output
    assert told in str(served.exception)


def test_an_address_without_its_protocol(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("longreach.fleet_client.time.sleep", lambda _s: pytest.fail("it waits for nobody"))
    with (
        JobClient("foo") as client,
        pytest.raises(JobRefusedError, match=r"'foo/?' is not an address; give one such as http"),
    ):
        client.wait_ready(30.0)


def test_a_machine_is_given_by_its_path_or_by_the_name_of_a_shipped_one(tmp_path: Path) -> None:
    shipped = file_of_machine(Path("hiab033"))
    assert shipped is not None
    assert shipped.is_file()
    own = tmp_path / "hiab033"
    own.write_text("")
    for kept in (None, own, Path("no-such"), Path("..") / "hiab033"):
        assert file_of_machine(kept) == kept
