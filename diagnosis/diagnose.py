"""The diagnosis as one call, for scripts and notebooks: `longreach.diagnose`."""

from collections.abc import Sequence
from pathlib import Path

from diagnosis.budget import Budget, budget_of
from diagnosis.errors import DiagnosisError
from diagnosis.reading.together import read_together


def diagnose(recordings: str | Path | Sequence[str | Path], machine_file: str | Path | None = None) -> Budget:
    """The error budget of a recording, or of several of one machine together.

    Args:    recordings: MCAP files or folders of CSV files. machine_file: in place of the one in the recording.
    Returns: what misses the tool by how much, which effects explain it, and how sure each is.
    Raises:  DiagnosisError: the recording cannot be read, or nothing in it can be judged; its findings say why.
    """
    given = [recordings] if isinstance(recordings, str | Path) else list(recordings)
    whole = read_together([Path(path) for path in given], None if machine_file is None else Path(machine_file))
    if not whole.has_judgeable_stage:
        raise DiagnosisError("; ".join(str(finding) for finding in whole.findings))
    return budget_of(whole)
