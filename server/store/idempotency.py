"""Idempotency keys: the same key and body get the same answer for 24 hours of operation, and nothing is done twice."""

import hashlib
import sqlite3
from dataclasses import dataclass

from server.access.errors import AccessError
from server.store.audit_rows import OPERATING_TIME_S_SQL

IDEMPOTENCY_KEY_TTL_S = 24 * 3600.0


class KeyReusedError(AccessError):
    """The key came before with another body."""

    code = "idempotency_key_reused"
    status = 422
    hint = "a new command needs a new Idempotency-Key"


class KeyInProgressError(AccessError):
    """The first request with this key has no answer yet."""

    code = "idempotency_in_progress"
    status = 409
    hint = "wait a moment and send it again with the same key"


class KeyMissingError(AccessError):
    """A fleet's command carries no key, so a retry could move twice."""

    code = "idempotency_key_missing"
    status = 400
    hint = "send the header Idempotency-Key with a fresh random value (such as a UUID) per command, the same on a retry"


@dataclass(frozen=True, slots=True)
class StoredAnswer:
    """What was answered to a key."""

    body_hash: str
    http_status: int
    location: str
    response_body: str


def hash_of(body: bytes) -> str:
    """Fingerprint of a request's body as it was sent."""
    return hashlib.sha256(body).hexdigest()


def replay_of(known: StoredAnswer | None, in_progress: bool, body_hash: str) -> StoredAnswer | None:
    """The answer to give again; None when the command is new and may be carried out.

    Raises: KeyReusedError: other body. KeyInProgressError: the first one is still on its way.
    """
    if known is not None:
        if known.body_hash != body_hash:
            raise KeyReusedError("this Idempotency-Key was used with another body")
        return known
    if in_progress:
        raise KeyInProgressError("a request with this Idempotency-Key is being worked on")
    return None


def read_answer(db: sqlite3.Connection, who: str, key: str) -> StoredAnswer | None:
    """What was answered to that caller's key within IDEMPOTENCY_KEY_TTL_S."""
    kept = f"operating_s > {OPERATING_TIME_S_SQL} - ?"
    row = db.execute(
        f"SELECT * FROM idempotency WHERE who = ? AND key = ? AND {kept}", (who, key, IDEMPOTENCY_KEY_TTL_S)
    ).fetchone()
    return None if row is None else StoredAnswer(row["body_hash"], row["status"], row["location"], row["answer"])


def forget_answer(db: sqlite3.Connection, who: str, key: str) -> None:
    """What was to be accepted was refused after all."""
    db.execute("DELETE FROM idempotency WHERE who = ? AND key = ?", (who, key))


def save_answer(db: sqlite3.Connection, who: str, key: str, answered: StoredAnswer) -> None:
    """Keep an answer; forget those of yesterday."""
    db.execute(f"DELETE FROM idempotency WHERE operating_s <= {OPERATING_TIME_S_SQL} - ?", (IDEMPOTENCY_KEY_TTL_S,))
    db.execute(
        "INSERT INTO idempotency (who, key, body_hash, status, location, answer, operating_s) "
        f"VALUES (?, ?, ?, ?, ?, ?, {OPERATING_TIME_S_SQL})",
        (who, key, answered.body_hash, answered.http_status, answered.location, answered.response_body),
    )
