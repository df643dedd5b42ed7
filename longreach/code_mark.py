"""Which code made what is on file: cases or answers of two versions are never taken for those of one."""

import hashlib
from pathlib import Path

CASES = ("diagnosis", "machine", "recording", "sim_plc/plant", "tests/gap_benchmark")
ENDINGS = (".py", ".json")


def code_mark(root: Path, sources: tuple[str, ...] = CASES) -> str:
    """Fingerprint of the code below these folders of `root`; by default all that makes, answers and judges a case."""
    digest = hashlib.sha256()
    files = (file for folder in sources for file in (root / folder).rglob("*") if file.suffix in ENDINGS)
    for file in sorted(files):
        digest.update(str(file.relative_to(root)).encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]
