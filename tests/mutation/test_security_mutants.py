"""Each test of the table of attacks (docs/security.md) can fail: take its defence away, and it does."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from security_mutants import MUTANTS

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
TESTS = ROOT / "tests" / "unit" / "api" / "test_api_security.py"
ELSEWHERE = {
    "test_api_commands.py",
    "tests/system/test_rest_slow_clients.py",
    "test_api_open_connections.py",
    "test_panel_hold.py",
}


def rows() -> list[tuple[str, list[str]]]:
    """(attack, tests) of the table in docs/security.md."""
    text = (ROOT / "docs" / "security.md").read_text(encoding="utf-8")
    table = text[text.index("| attack | answer | test |") :].split("\n\n")[0].splitlines()[2:]
    return [(line.split("|")[1].strip(), re.findall(r"`([^`]+)`", line.split("|")[3])) for line in table]


def test_every_row_names_a_test_that_there_is():
    assert len(rows()) >= 14
    source = TESTS.read_text(encoding="utf-8")
    for attack, names in rows():
        assert names, attack
        for name in names:
            there = f"def {name}(" in source if name.startswith("test_") and "." not in name else name in ELSEWHERE
            assert there, f"{attack}: {name}"


def test_every_test_of_the_table_has_a_mutant_that_it_must_notice():
    named = {name for _, names in rows() for name in names if "." not in name}
    assert named == {killer for _, killer in MUTANTS.values()}


@pytest.mark.slow
@pytest.mark.parametrize("mutant", MUTANTS)
def test_without_its_defence_the_attack_is_noticed(mutant):
    _, killer = MUTANTS[mutant]
    environment = os.environ | {"LONGREACH_MUTANT": mutant, "PYTHONPATH": str(HERE)}
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-x",
        "-p",
        "security_mutants",
        "-p",
        "no:cacheprovider",
        "--timeout=40",
    ]
    command += [f"{TESTS}", "-k", killer]
    code, told = run(command, environment)
    assert code != 0, f"{killer} does not notice that {mutant}\n{told[-2000:]}"
    assert re.search(r"^\.*F|FAILED|Timeout", told, re.M), told[-2000:]


def run(command: list[str], environment: dict[str, str]) -> tuple[int, str]:
    """Exit code and output; a mutant that let something begin may keep pytest from its end, long after the verdict."""
    with subprocess.Popen(
        command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        try:
            told, _ = process.communicate(timeout=90)
        except subprocess.TimeoutExpired:
            process.kill()
            told, _ = process.communicate()
    return process.returncode, told
