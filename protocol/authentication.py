"""Optional authentication of both directions: HMAC-SHA-256, cut to 16 bytes, over everything before the tag.

It keeps a stranger on the network from commanding the machine; it does not hide anything and is not a safety measure.
Source: RFC 2104; a replayed old datagram is refused by session, sequence and arm nonce.
"""

import hmac

from protocol.errors import LocalProtocolError

AUTH_TAG_BYTES = 16
KEY_MIN, KEY_MAX = 16, 64  # bytes; more than one SHA-256 block would be hashed first and gains nothing


def checked_key(key: bytes) -> bytes:
    """The key, if it is empty (no authentication) or of a length that protects.

    Raises: LocalProtocolError: another length.
    """
    if key and not KEY_MIN <= len(key) <= KEY_MAX:
        raise LocalProtocolError(
            f"authentication key of {len(key)} bytes: give {KEY_MIN}..{KEY_MAX} random bytes, or none"
        )
    return key


def parse_key(text: str) -> bytes:
    """A key from its hexadecimal text; empty text means no key.

    Raises: LocalProtocolError: not hexadecimal, or a bad length.
    """
    try:
        key = bytes.fromhex(text.strip())
    except ValueError:
        raise LocalProtocolError(
            "authentication key: must be hexadecimal digits, such as from `openssl rand -hex 32`"
        ) from None
    return checked_key(key)


def tag_of(key: bytes, signed: bytes) -> bytes:
    """The 16 bytes that go with everything before the tag."""
    return hmac.digest(key, signed, "sha256")[:AUTH_TAG_BYTES]


def is_authentic(key: bytes, signed: bytes, tag: bytes) -> bool:
    """Whether the tag is the right one; takes the same time whatever the answer."""
    return hmac.compare_digest(tag_of(key, signed), tag)
