"""A fleet's recordings over an executor: saved one by one, resumed, never stopped by a bad one."""

import hashlib
import json
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

from diagnosis.fleet.case import diagnose_case, fingerprint
from diagnosis.fleet.workers import Workers
from recording.files import write_durably

Report = Callable[[str, int, int], None]


def recordings_below(folder: Path) -> list[Path]:
    """MCAP files and CSV folders (those with a run.toml) below a folder, in name order."""
    files = sorted(folder.rglob("*.mcap"))
    folders = sorted(settings.parent for settings in folder.rglob("run.toml"))
    return sorted({*files, *folders})


def diagnose_all(
    paths: Sequence[Path],
    saved: Path,
    executor: Executor,
    version: str,
    machine_file: Path | None = None,
    report: Report = lambda _name, _done, _total: None,
    at_once: int = 64,
    renewed: Callable[[], Executor] | None = None,
    base: Path | None = None,
) -> list[dict[str, Any]]:
    """Diagnose every recording, in the order of `paths`, at most `at_once` handed out at a time.

    Args: saved: folder in which each answer lies; what is there and still holds is not computed again.
          renewed: gives an executor in place of one that broke because a worker of it died.
          base: folder that the recordings are called by their places below; their own names without one.
    """
    saved.mkdir(parents=True, exist_ok=True)
    shown = [path.name if base is None else path.relative_to(base).as_posix() for path in paths]
    names = [_name(path, base) for path in paths]
    called = dict(zip(names, shown, strict=True))
    results: dict[str, dict[str, Any]] = {}
    marks = {name: fingerprint(path, machine_file, version) for name, path in zip(names, paths, strict=True)}
    for name in names:
        known = _load_cached_result(saved / f"{name}.json", marks[name])
        if known is not None:
            results[name] = known
    file = None if machine_file is None else str(machine_file.resolve())
    paired = zip(names, paths, strict=True)
    todo = [(name, (str(path.resolve()), file)) for name, path in paired if name not in results]
    for name, future in Workers(executor, renewed).run(diagnose_case, todo, at_once):
        results[name] = result = _worker_result(called[name], future)
        _save(saved / f"{name}.json", marks[name], result)
        report(called[name], len(results), len(names))
    return [results[name] for name in names]


def _worker_result(name: str, future: Future[dict[str, Any]]) -> dict[str, Any]:
    """A worker that died takes one recording along, not the fleet."""
    error = future.exception()
    if error is not None:
        return {"status": "failed", "recording": name, "reason": f"{type(error).__name__}: {error}"}
    return {**future.result(), "recording": name}


def _name(path: Path, base: Path | None) -> str:
    """What a recording's answer is kept as: of its own place only, so that one more in the folder renames none."""
    place = path.resolve() if base is None else path.relative_to(base)
    return f"{path.name.removesuffix('.mcap')}-{hashlib.sha256(place.as_posix().encode()).hexdigest()[:8]}"


def _load_cached_result(file: Path, mark: str) -> dict[str, Any] | None:
    try:
        held = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    ok = isinstance(held, dict) and held.get("fingerprint") == mark and isinstance(held.get("result"), dict)
    return held["result"] if ok and held["result"].get("status") != "failed" else None


def _save(file: Path, mark: str, result: dict[str, Any]) -> None:
    write_durably(file, json.dumps({"fingerprint": mark, "result": result}, indent=1) + "\n")
