"""The C header compiles as C11 and as C++, its assertions bite, and a C program reads a golden command with it."""

import shutil
import subprocess
from pathlib import Path

import pytest
from export_parts import PARAMETERS, exported

from protocol import codes, layout
from protocol.twincat.golden import golden_messages

GCC, GXX = shutil.which("gcc"), shutil.which("g++")
needs_gcc = pytest.mark.skipif(GCC is None, reason="gcc is not installed (Debian: apt-get install gcc)")
needs_gxx = pytest.mark.skipif(GXX is None, reason="g++ is not installed (Debian: apt-get install g++)")
STRICT = ("-Wall", "-Wextra", "-Wpadded", "-Werror")
HEADER = exported()["c/hmlink.h"].decode()
READER = r"""
#include <stdio.h>
#include <string.h>
#include "hmlink.h"
int main(int argc, char **argv) {
    unsigned char bytes[sizeof(hm_command_t)];
    hm_command_t c;
    FILE *file = fopen(argv[argc - 1], "rb");
    if (file == NULL || fread(bytes, 1, sizeof bytes, file) != sizeof bytes) return 1;
    memcpy(&c, bytes, sizeof c);
    printf("%u %d %u %u %.17g %.17g %u", c.seq, c.mode == HM_MODE_TRAJECTORY, c.knot_count, c.timeout_us,
           c.speed_override, c.knots[1].q[0], c.crc);
    return c.magic == HM_COMMAND_MAGIC && c.layout_id == HM_LAYOUT_ID ? 0 : 2;
}
"""


def compiled(compiler: str | None, folder: Path, text: str, *options: str) -> subprocess.CompletedProcess[str]:
    assert compiler is not None
    folder.joinpath("hmlink.h").write_text(text)
    source = folder / "use.c"
    source.write_text('#include "hmlink.h"\n#include "hmlink.h"\n')
    command = [compiler, *options, "-fsyntax-only", str(source)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


@needs_gcc
def test_it_is_c11_and_pads_nothing(tmp_path):
    done = compiled(GCC, tmp_path, HEADER, "-std=c11", "-pedantic", *STRICT)
    assert (done.returncode, done.stderr) == (0, "")


@needs_gxx
@pytest.mark.parametrize("standard", ["c++11", "c++20"])
def test_it_is_cpp(tmp_path, standard):
    done = compiled(GXX, tmp_path, HEADER, f"-std={standard}", "-x", "c++", "-pedantic", *STRICT)
    assert (done.returncode, done.stderr) == (0, "")


@needs_gcc
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("uint32_t reject_offset;", "uint16_t reject_offset;"),
        ("    uint32_t knot_first; /* 60 */\n", ""),
        ("double qd[8]; /* 72 */\n    double qdd[8]; /* 136 */", "double qdd[8];\n    double qd[8];"),
        ("sizeof(hm_limits_t) == 288", "sizeof(hm_limits_t) == 287"),
    ],
)
def test_its_assertions_bite(tmp_path, old, new):
    assert HEADER.count(old) == 1
    assert compiled(GCC, tmp_path, HEADER.replace(old, new), "-std=c11").returncode != 0


@needs_gcc
def test_a_c_program_reads_a_golden_command(tmp_path):
    assert GCC is not None
    (golden,) = (golden for golden in golden_messages(PARAMETERS) if golden.name == "trajectory")
    (tmp_path / "hmlink.h").write_text(HEADER)
    (tmp_path / "reader.c").write_text(READER)
    (tmp_path / "command.bin").write_bytes(golden.payload)
    program = tmp_path / "reader"
    build = [GCC, "-std=c11", *STRICT[:2], "-Werror", str(tmp_path / "reader.c"), "-o", str(program)]
    subprocess.run(build, check=True, timeout=60)
    done = subprocess.run(
        [str(program), str(tmp_path / "command.bin")], capture_output=True, text=True, check=True, timeout=10
    )
    seq, is_trajectory, count, timeout_us, override, q, crc = done.stdout.split()
    assert (seq, is_trajectory, count, timeout_us, override) == ("27", "1", "6", "250000", "1")
    assert float(q) == golden.message.knots[1].q[0]  # type: ignore[union-attr]
    assert int(crc) == int.from_bytes(golden.payload[-4:], "little")


def test_every_field_and_code_is_asserted_or_numbered():
    assert "#pragma" not in HEADER
    for kind, prefix in ((codes.RejectCode, "REJECT_CODE"), (codes.FaultBit, "FAULT_BIT"), (codes.Mode, "MODE")):
        for member in kind:
            assert f"HM_{prefix}_{member.name} = {int(member)}" in HEADER
    fields = len(layout.HEADER_LAYOUT.fields) + len(layout.STATE_BODY_LAYOUT.fields)
    assert HEADER.count("HM_ASSERT(offsetof(hm_state_t") == HEADER.count("HM_ASSERT(sizeof(((hm_state_t") == fields
    assert "CRC-32 (IEEE 802.3, as zlib's) of all bytes before" in HEADER
