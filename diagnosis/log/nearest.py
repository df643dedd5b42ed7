"""Which known name an unknown one may have meant."""

import difflib
from collections.abc import Iterable

SIMILARITY_CUTOFF = 0.6  # of difflib's likeness
PREFIX_LETTERS_MIN = 2  # letters of a name that was cut short


def nearest_name(name: str, known: Iterable[str]) -> str | None:
    """The likeliest known name: what this one begins, else what is spelt like it, small and capital letters alike."""
    by_lower = {name.lower(): name for name in sorted(known)}
    wanted = name.lower()
    if wanted in by_lower:
        return by_lower[wanted]
    begun = [name for name in by_lower if len(wanted) >= PREFIX_LETTERS_MIN and name.startswith(wanted)]
    close = difflib.get_close_matches(wanted, list(by_lower), n=1, cutoff=SIMILARITY_CUTOFF)
    found = close or begun
    return by_lower[found[0]] if found else None


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """The end of a sentence that names it; empty where none is near."""
    found = nearest_name(name, known)
    return "" if found is None else f"; did you mean {found!r}?"
