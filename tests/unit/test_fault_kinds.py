"""docs/fault-kinds.md names tests and functions that exist."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/fault-kinds.md").read_text(encoding="utf-8")


def test_every_test_that_the_page_names_exists() -> None:
    files = {file.name: file.read_text(encoding="utf-8") for file in (ROOT / "tests").rglob("test_*.py")}
    named = re.findall(r"`(test_\w+\.py)(?:::(test_\w+))?`", PAGE)
    assert named
    assert [(file, test) for file, test in named if f"def {test}" not in files.get(file, "")] == []


def test_every_file_and_function_that_the_page_names_exists() -> None:
    product = "".join(
        file.read_text(encoding="utf-8")
        for package in ("server", "sim_plc", "machine", "protocol", "recording", "longreach", "benchmarks")
        for file in (ROOT / package).rglob("*.py")
    )
    files = re.findall(r"`((?:server|sim_plc|machine|protocol|recording|longreach|benchmarks)/[\w/]+\.py)`", PAGE)
    assert [file for file in files if not (ROOT / file).is_file()] == []
    functions = re.findall(r"\(`(\w+)`", PAGE)
    assert [name for name in functions if name not in product and not name.startswith("test_")] == []
