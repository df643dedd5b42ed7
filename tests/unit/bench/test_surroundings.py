"""What a command does about its surroundings: the working folder, proxies, folders that cannot be written, signals."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from longreach import cli as surroundings
from longreach.cli import prepare
from longreach.fleet_client import JobClient, JobRefusedError, SteadyClient, by_proxy

ROOT = Path(__file__).parents[3]
NAMES = ("machine", "server", "recording", "selectors", "random", "numba")
CHILDREN = """
import json, multiprocessing, subprocess, sys
from concurrent.futures import ProcessPoolExecutor

def path():
    return sys.path

if __name__ == "__main__":
    from longreach.cli import prepare
    prepare()
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        found = [pool.submit(path).result()]
    told = subprocess.run([sys.executable, "-c", "import json, sys; print(json.dumps(sys.path))"], capture_output=True)
    print(json.dumps([*found, json.loads(told.stdout)]))
"""


def foreign(folder: Path) -> Path:
    """A working folder whose files have the names of our modules and of others'."""
    folder.mkdir()
    for name in NAMES:
        (folder / f"{name}.py").write_text("raise SystemExit('a file of the working folder was imported')\n")
    return folder


def environment(**more: str) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT), **more}


def test_no_child_process_however_started_imports_from_the_working_folder(tmp_path: Path) -> None:
    (script := tmp_path / "children.py").write_text(CHILDREN)
    cwd = foreign(tmp_path / "work")
    done = subprocess.run(
        [sys.executable, "-P", str(script)],
        cwd=cwd,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    for path in json.loads(done.stdout):
        assert not {"", str(cwd)} & set(path)


def test_a_command_runs_where_files_have_the_names_of_its_modules(tmp_path: Path) -> None:
    code = (
        "import sys; sys.argv = ['longreach', 'keys', 'list', '--file', 'none']; from longreach.cli import main; main()"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", code],
        cwd=foreign(tmp_path / "work"),
        env=environment(),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert "was imported" not in done.stdout + done.stderr


def test_every_python_that_is_started_by_module_is_started_with_p() -> None:
    sources = [path for top in ("longreach", "server") for path in (ROOT / top).rglob("*.py")]
    assert sources
    assert [path for path in sources if 'sys.executable, "-m"' in path.read_text(encoding="utf-8")] == []


def test_a_proxy_is_never_asked_for_this_computer_and_named_where_another_is_not_reached(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("no_proxy", "NO_PROXY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("http_proxy", "http://proxy.invalid:3128")
    for url in ("http://127.0.0.1:8080", "http://localhost:8080", "http://[::1]:8080", "http://127.7.7.7:1"):
        with SteadyClient(url, 1.0) as client:
            assert client._transport_for_url(httpx.URL(url)) is client._transport
        assert by_proxy(url) == ""
    with SteadyClient("http://crane-7:8080", 1.0) as client:
        assert client._transport_for_url(httpx.URL("http://crane-7:8080")) is not client._transport
    told = "through the proxy http://proxy.invalid:3128 (http_proxy); add crane-7 to no_proxy"
    assert told in by_proxy("http://crane-7:8080")
    with JobClient("http://crane-7:8080", timeout_s=1.0) as client, pytest.raises(JobRefusedError) as refused:
        client.wait_ready(0.1)
    assert told in str(refused.value)


def test_a_proxys_page_in_place_of_an_answer_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("http_proxy", "http://proxy.invalid:3128")
    monkeypatch.delenv("no_proxy", raising=False)
    with JobClient("http://crane-7:8080") as client:
        page = httpx.MockTransport(lambda _request: httpx.Response(403, text="<html>denied</html>"))
        client._http = httpx.Client(base_url="http://crane-7:8080", transport=page)
        with pytest.raises(
            JobRefusedError,
            match=r"answers 403 Forbidden, which is not a longreach answer; the request went .*3128",
        ):
            client.wait_ready(0.1)
        with pytest.raises(JobRefusedError, match="403 Forbidden"):
            client.run({"kind": "look"})


def test_what_is_started_from_here_asks_this_computer_directly_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("no_proxy", "intranet,127.0.0.1")
    monkeypatch.delenv("NO_PROXY", raising=False)
    monkeypatch.setenv("PYTHONSAFEPATH", "1")
    prepare()
    assert os.environ["no_proxy"] == "intranet,127.0.0.1,localhost,::1"
    assert os.environ["NO_PROXY"] == "127.0.0.1,localhost,::1"


def test_code_is_compiled_into_a_temporary_cache_where_nothing_can_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in (surroundings.NUMBA_CACHE_ENV_VARIABLE, "no_proxy", "NO_PROXY", "PYTHONSAFEPATH"):
        monkeypatch.setenv(name, "")
    monkeypatch.setattr(surroundings.tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr(surroundings, "_is_folder_writable", lambda folder: tmp_path in folder.parents)
    prepare()
    made = Path(os.environ[surroundings.NUMBA_CACHE_ENV_VARIABLE])
    assert made.parent == tmp_path
    assert made.stat().st_mode & 0o777 == 0o700
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert str(made) in said
    prepare()  # a child process: the same folder, and nothing more to say
    assert (os.environ[surroundings.NUMBA_CACHE_ENV_VARIABLE], capsys.readouterr().err) == (str(made), "")
    monkeypatch.setenv(surroundings.NUMBA_CACHE_ENV_VARIABLE, "")
    made.chmod(0o777)  # somebody else's files in it would be run
    prepare()
    assert os.environ[surroundings.NUMBA_CACHE_ENV_VARIABLE] != str(made)


def test_an_images_compiled_code_is_used_from_where_it_can_only_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    image = tmp_path / "image"
    (image / "kinematics_1a").mkdir(parents=True)
    (image / "kinematics_1a" / "tcp_pose.nbi").write_bytes(b"index")
    (image / surroundings.COMPILED_CODE_MARK_FILE).write_text("{}")
    for name in ("no_proxy", "NO_PROXY", "PYTHONSAFEPATH"):
        monkeypatch.setenv(name, "")
    monkeypatch.setenv(surroundings.NUMBA_CACHE_ENV_VARIABLE, str(image))
    monkeypatch.setattr(surroundings.tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr(surroundings, "_is_folder_writable", lambda folder: image not in (folder, *folder.parents))
    for _ in range(2):  # a second process finds what the first one made
        monkeypatch.setenv(surroundings.NUMBA_CACHE_ENV_VARIABLE, str(image))
        prepare()
        used = Path(os.environ[surroundings.NUMBA_CACHE_ENV_VARIABLE])
        assert used != image
        assert (used / "kinematics_1a" / "tcp_pose.nbi").read_bytes() == b"index"
        assert (used / surroundings.COMPILED_CODE_MARK_FILE).is_file()
    (used / "kinematics_1a" / "tcp_pose.nbi").unlink()  # numba replaces it by what it compiles
    assert (image / "kinematics_1a" / "tcp_pose.nbi").read_bytes() == b"index"
    assert capsys.readouterr().err == ""


MASKED = """
import multiprocessing, signal
from recording.spawn import out_of_the_terminals_reach

def masked(pipe):
    pipe.send(sorted(signal.pthread_sigmask(signal.SIG_BLOCK, ())))

if __name__ == "__main__":
    context = multiprocessing.get_context("spawn")
    for _ in range(2):
        ours, theirs = context.Pipe()
        child = context.Process(target=masked, args=(theirs,))
        with out_of_the_terminals_reach():
            child.start()
        print([int(number) for number in ours.recv()], sorted(signal.pthread_sigmask(signal.SIG_BLOCK, ())))
        child.join()
"""


def test_a_terminals_signals_are_blocked_in_the_first_child_already_and_not_in_its_parent(tmp_path: Path) -> None:
    (script := tmp_path / "masked.py").write_text(MASKED)
    done = subprocess.run(
        [sys.executable, "-P", str(script)], env=environment(), capture_output=True, text=True, timeout=120
    )
    wanted = [int(number) for number in sorted((signal.SIGINT, signal.SIGHUP))]
    assert done.stdout.splitlines() == [f"{wanted} []"] * 2, done.stderr


SLEEPER = """
import time
from longreach.signals import end_as_by_ctrl_c, exit_code
end_as_by_ctrl_c()
try:
    print("ready", flush=True)
    time.sleep(60)
except KeyboardInterrupt:
    print("as by Ctrl-C", flush=True)
    raise SystemExit(exit_code(130))
"""


@pytest.mark.parametrize("sigint", [signal.SIG_DFL, signal.SIG_IGN])
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_that_ends_a_program_is_handled_as_ctrl_c(number: int, sigint: signal.Handlers) -> None:
    """Also where a shell has started it in the background, with Ctrl-C ignored."""
    program = subprocess.Popen(
        [sys.executable, "-P", "-c", SLEEPER],
        stdout=subprocess.PIPE,
        text=True,
        env=environment(),
        preexec_fn=lambda: signal.signal(signal.SIGINT, sigint),
    )
    assert program.stdout is not None
    with program, program.stdout:
        assert program.stdout.readline() == "ready\n"
        program.send_signal(number)
        assert program.wait(30.0) == 128 + number
        assert program.stdout.read() == "as by Ctrl-C\n"


def test_under_nohup_a_closed_terminal_ends_nothing() -> None:
    code = SLEEPER.replace("time.sleep(60)", "time.sleep(0.5)")
    program = subprocess.Popen(
        [sys.executable, "-P", "-c", code],
        stdout=subprocess.PIPE,
        text=True,
        env=environment(),
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN),
    )
    assert program.stdout is not None
    with program, program.stdout:
        assert program.stdout.readline() == "ready\n"
        program.send_signal(signal.SIGHUP)
        assert program.wait(30.0) == 0


def test_the_python_api_has_a_place_for_compiled_code_where_nothing_can_be_written(tmp_path: Path) -> None:
    code = (
        "import os, tempfile; from pathlib import Path; import longreach.cli as cli\n"
        "cli._is_folder_writable = lambda folder: False\n"
        "import numba, longreach; longreach.tcp_pose\n"
        "assert os.environ[cli.NUMBA_CACHE_ENV_VARIABLE] == numba.config.CACHE_DIR != '', numba.config.CACHE_DIR\n"
    )
    surrounded = os.environ | {"TMPDIR": str(tmp_path), surroundings.NUMBA_CACHE_ENV_VARIABLE: ""}
    done = subprocess.run([sys.executable, "-c", code], env=surrounded, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "compiled code is kept in" in done.stderr
