"""What `longreach diagnose` answers of a recording in memory."""

from pathlib import Path
from typing import Any

from diagnosis.answer import answer
from diagnosis.budget import budget_of
from diagnosis.reading.read import examine
from recording.content import Recording


def answered(recording: Recording) -> dict[str, Any]:
    """The answer of the contract. Raises: RuntimeError: the recording cannot be diagnosed."""
    whole = examine(recording, Path("bench"))
    if not whole.usable:
        raise RuntimeError("; ".join(str(one) for one in whole.findings))
    return answer(budget_of(whole))
