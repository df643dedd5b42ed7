"""Fingerprint of the code that produced stored results, so that results of two versions are never mixed."""

import hashlib
from pathlib import Path

ENDINGS = (".py", ".json")


def code_mark(root: Path, sources: tuple[str, ...]) -> str:
    """Fingerprint of the code below these folders of `root`."""
    digest = hashlib.sha256()
    files = (file for folder in sources for file in (root / folder).rglob("*") if file.suffix in ENDINGS)
    for file in sorted(files):
        digest.update(str(file.relative_to(root)).encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]
