"""What `longreach diagnose` answers of a recording in memory."""

from pathlib import Path
from typing import Any

from diagnosis.answer import answer_json
from diagnosis.budget import budget_of
from diagnosis.reading.read import examine_recording
from recording.content import Recording


def answered(recording: Recording) -> dict[str, Any]:
    """The answer of the contract. Raises: RuntimeError: the recording cannot be diagnosed."""
    whole = examine_recording(recording, Path("bench"))
    if not whole.has_judgeable_stage:
        raise RuntimeError("; ".join(str(one) for one in whole.findings))
    return answer_json(budget_of(whole))
