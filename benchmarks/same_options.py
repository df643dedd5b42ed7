"""Cases on file are of one configuration: a run with other options must not print them as its own."""

import hashlib
import json
from pathlib import Path

from recording.files import write_durably
from server.errors import SettingsError

FILE = "options.json"
REMEDY = "give another --folder, or delete this one"


def require_same_options(folder: Path, **options: float | str) -> None:
    """Write down what shapes every case of a folder, or compare with what was written when its first case was made.

    What is part of a case's name or key, such as its seed, need not be among the options.
    Raises: SettingsError: which option is another one; or there are cases, and nobody wrote down what they are of.
    """
    file = folder / FILE
    if file.is_file():
        _compare(folder, json.loads(file.read_text(encoding="utf-8")), options)
        return
    if folder.is_dir() and any(folder.iterdir()):
        raise SettingsError(f"{folder} holds cases but no {FILE}: it is not known what they were made with; {REMEDY}")
    folder.mkdir(parents=True, exist_ok=True)
    write_durably(file, json.dumps(options, indent=1))


def _compare(folder: Path, held: dict[str, float | str], asked: dict[str, float | str]) -> None:
    other = [
        f"{name} {held.get(name, 'not told')}, asked for {asked.get(name, 'nothing')}"
        for name in sorted({*held, *asked})
        if held.get(name) != asked.get(name)
    ]
    if other:
        raise SettingsError(f"{folder}: its cases were made with {'; '.join(other)}; {REMEDY}")


def text_mark(text: str) -> str:
    """A short fingerprint of a file's text, such as a machine's: its name says nothing of what is in it."""
    return f"SHA-256 {hashlib.sha256(text.encode()).hexdigest()[:12]}"
