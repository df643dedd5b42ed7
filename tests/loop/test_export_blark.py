"""An independent parser of TwinCAT's Structured Text reads what we export (syntax only; types: structured_text/)."""

import re
import subprocess
import sys
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path

import pytest

from longreach.export_command import plc_parameters, st_sources
from protocol.twincat.bundle import project
from protocol.twincat.solution import PLC_PROJECT_NAME, solution_files
from server.settings import read_machine

pytestmark = [
    pytest.mark.slow,  # blark takes seconds a block
    pytest.mark.skipif(find_spec("blark") is None, reason="blark is not installed (pip install blark)"),
]
PARAMETERS = plc_parameters(read_machine("hiab033"), "192.168.0.10.1.1", "192.168.0.20.1.1")
FILES = project(PARAMETERS, st_sources())
LONG_BYTES = 7500  # longer blocks take seconds each: in make test-slow
_LIST = re.compile(rb"(?:16#[0-9A-F_]+,\s*){100,}")


def written(folder: Path, files: Iterable[str]) -> Path:
    """The project file as delivered, around some of the exported files, so that one call reads all of them."""
    folder.mkdir(exist_ok=True)
    chosen = {path: shortened(FILES[path]) for path in files}
    for path, data in (chosen | solution_files(PARAMETERS, chosen)).items():
        (folder / path).parent.mkdir(exist_ok=True)
        (folder / path).write_bytes(data)
    return folder / f"{PLC_PROJECT_NAME}.plcproj"


def shortened(data: bytes) -> bytes:
    """Long lists of constants cut: blark's time grows with their square. FB_HmSelfCheck tests the CRC table whole."""
    return _LIST.sub(b"16#0, ", data)


def blark(file: Path) -> tuple[int, set[str], str]:
    """Exit code, names of the files read, output. A command of its own: blark is GPL and never imported."""
    program = Path(sys.executable).with_name("blark")
    command = [str(program), "parse", "--print-filename", str(file)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    text = done.stdout + done.stderr
    return done.returncode, set(re.findall(r"Parsing \S*/(\w+/\w+\.Tc\w+):", text)), text[-800:]


def assert_read(folder: Path, paths: Iterable[str]) -> None:
    paths = sorted(paths)
    code, read, text = blark(written(folder, paths))
    assert code == 0, text
    assert read == set(paths)  # a file that it does not find it passes over


def test_some_of_every_kind_is_read(tmp_path: Path) -> None:
    kinds = ("DUTs/ST_HmCmd.TcDUT", "DUTs/U_HmCmd.TcDUT", "DUTs/E_HmReject.TcDUT", "GVLs/GVL_HmIo.TcGVL")
    assert_read(tmp_path, (*kinds, "POUs/FB_HmJointPT1.TcPOU", "POUs/F_HmClamp.TcPOU"))


def test_the_solution_leads_to_the_files(tmp_path: Path) -> None:
    paths = ["POUs/F_HmClamp.TcPOU", "GVLs/GVL_HmIo.TcGVL", "DUTs/ST_HmCmd.TcDUT"]
    code, read, text = blark(written(tmp_path, paths).with_suffix(".sln"))
    assert code == 0, text
    assert read == set(paths)


@pytest.mark.timeout(1800)
def test_types_constants_and_short_blocks_are_read(tmp_path: Path) -> None:
    short = {path for path, data in FILES.items() if len(shortened(data)) < LONG_BYTES}
    assert {"POUs/MAIN.TcPOU", "POUs/FB_HmUdpTf6310.TcPOU", "POUs/FB_HmUdpTf6311.TcPOU", "POUs/F_HmCrc32.TcPOU",
            "POUs/F_HmNextState.TcPOU", "GVLs/GVL_HmMachine.TcGVL"} <= short  # fmt: skip
    assert {path for path in FILES if not path.startswith("POUs/")} <= short
    assert_read(tmp_path, short)


def test_blark_does_complain_of_broken_text_and_names_the_file(tmp_path: Path) -> None:
    target = written(tmp_path, ["POUs/F_HmClamp.TcPOU", "POUs/MAIN.TcPOU"])
    main = tmp_path / "POUs" / "MAIN.TcPOU"
    main.write_bytes(main.read_bytes().replace(b"END_IF", b"END_FI", 1))
    code, _, text = blark(target)
    assert code != 0
    assert "MAIN.TcPOU: MAIN/implementation" in text


def test_the_crc_table_is_what_is_shortened() -> None:
    assert [path for path, data in FILES.items() if shortened(data) != data] == ["POUs/F_HmCrc32.TcPOU"]


@pytest.mark.timeout(1200)
def test_every_file_is_read(tmp_path: Path) -> None:
    by_size = sorted(FILES, key=lambda path: len(FILES[path]))
    with ThreadPoolExecutor(2) as pool:
        halves = [pool.submit(assert_read, tmp_path / f"half{i}", by_size[i::2]) for i in range(2)]
        for half in halves:
            half.result()
