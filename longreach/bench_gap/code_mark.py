"""Which code made a campaign's cases: cases of two versions are never counted together."""

import hashlib
from pathlib import Path

SOURCES = ("diagnosis", "machine", "recording", "sim_plc/plant", "tests/gap_benchmark")
ENDINGS = (".py", ".json")


def code_mark(root: Path) -> str:
    """Fingerprint of everything that makes, answers and judges a case, in the source tree at `root`."""
    digest = hashlib.sha256()
    files = (file for folder in SOURCES for file in (root / folder).rglob("*") if file.suffix in ENDINGS)
    for file in sorted(files):
        digest.update(str(file.relative_to(root)).encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]
