"""Is a JPEG's data whole? Every code word is read, without making a picture of it. Pure.

A decoder makes a picture of anything: after a flipped bit it finds its step again some blocks later, and from there on
the picture is shifted by whole blocks, in both eyes alike, so that markers fit their poses as before. libjpeg warns of
what is left over at the end only from eight bytes on, which is several plain blocks.
"""

from dataclasses import dataclass, field
from functools import lru_cache

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Codes = NDArray[np.uint16]

START, END, SCAN, TABLES, INTERVAL, RESTART = 0xD8, 0xD9, 0xDA, 0xC4, 0xDD, 0xD0
SEQUENTIAL_FRAME_MARKERS = (0xC0, 0xC1)  # baseline and extended, Huffman
UNSUPPORTED_FRAME_MARKERS = frozenset(range(0xC2, 0xD0)) - {TABLES, 0xC8, 0xCC}
STANDALONE_MARKERS = frozenset({0x01, *range(RESTART, RESTART + 8)})  # markers without content
CODE_WORD_BITS_MAX = 16  # of the longest code word
DC_BITS_MAX = 11  # of the difference of two means, at 8 bits a pixel
CODE_AND_VALUE_BITS_MAX = CODE_WORD_BITS_MAX + 15  # of a code word and the value behind it
SCAN_FAULT_TEXTS = (
    "",
    "a code word that its table does not have",
    "a block of more than 64 values",
    "its data end early",
    "data are left over",
    "a restart marker is missing or out of turn",
)
_FINE, _CODE, _BLOCK, _EARLY, _LEFT_OVER, _RESTART = range(6)


@dataclass(frozen=True, slots=True)
class _Frame:
    """Size [px], and sampling factors (across, down) of each component by its number."""

    width: int = 0
    height: int = 0
    sampling: dict[int, tuple[int, int]] = field(default_factory=dict)


def damage_of(jpeg: Bytes) -> str:
    """Why these bytes cannot be what an encoder wrote; empty when nothing contradicts that.

    Model:   each scan holds exactly the blocks of its frame, only code words of its tables, 64 values a block, less
             than a byte of equal padding bits before each marker, restart markers in turn. Bytes behind the last scan,
             a missing end marker and missing tables (then the standard's, as USB cameras mean it) contradict nothing.
    Source:  ITU-T T.81, F.1.2 (code words, padding), E.1.4 (restart), K.3.3 (the standard's tables).
    """
    try:
        return _find_jpeg_damage(jpeg)
    except (IndexError, ValueError):
        return "its header is cut or contradicts itself"


def _find_jpeg_damage(jpeg: Bytes) -> str:
    frame, tables, interval, position = _Frame(), b"", 0, 2
    missing: set[int] = set()
    while True:
        if jpeg[position] != 0xFF:
            return f"no marker at byte {position}, where one is due"
        marker = int(jpeg[position + 1])
        if marker == 0xFF or marker in STANDALONE_MARKERS:  # a byte that fills up, or a marker by itself
            position += 1 if marker == 0xFF else 2
            continue
        if marker == END:
            return "its data are missing"
        content = jpeg[position + 4 : position + 2 + _big_endian_uint16(jpeg, position + 2)]
        position += 4 + len(content)
        if marker in UNSUPPORTED_FRAME_MARKERS:
            return "it is not a baseline JPEG, and cannot be checked for damage; set its encoder to baseline"
        if marker in SEQUENTIAL_FRAME_MARKERS:
            frame = _frame_of(content)
            missing = set(frame.sampling)
        elif marker == TABLES:
            tables += content.tobytes()
        elif marker == INTERVAL:
            interval = _big_endian_uint16(content, 0)
        elif marker == SCAN:
            seen, dc, ac, n_units = _scan_layout(content, frame)
            fault, unit, position = _read(
                jpeg, position, _huffman_lookup_tables(tables or _standard_huffman_tables()), dc, ac, n_units, interval
            )
            if fault != _FINE:
                return f"{SCAN_FAULT_TEXTS[fault]} at block {unit} of {n_units}"
            missing -= seen
            if not missing:
                return ""


def _big_endian_uint16(content: Bytes, at: int) -> int:
    return int(content[at]) << 8 | int(content[at + 1])


def _frame_of(content: Bytes) -> _Frame:
    factors = {
        int(content[at]): (int(content[at + 1]) >> 4, int(content[at + 1]) & 15)
        for at in range(6, 6 + 3 * int(content[5]), 3)
    }
    if not factors or not all(1 <= factor <= 4 for pair in factors.values() for factor in pair):
        raise ValueError("sampling factors outside 1..4")
    return _Frame(_big_endian_uint16(content, 3), _big_endian_uint16(content, 1), factors)


def _scan_layout(content: Bytes, frame: _Frame) -> tuple[set[int], NDArray[np.int64], NDArray[np.int64], int]:
    """Components of a scan; rows of `_huffman_lookup_tables` for each block of a unit, DC and AC; number of units."""
    chosen = {int(content[at]): int(content[at + 1]) for at in range(1, 1 + 2 * int(content[0]), 2)}
    if not chosen or not chosen.keys() <= frame.sampling.keys() or max(choice >> 4 for choice in chosen.values()) > 3:
        raise ValueError("a scan of components that the frame does not have")
    across, down = (max(pair[axis] for pair in frame.sampling.values()) for axis in (0, 1))
    if len(chosen) == 1:  # block by block, without padding to whole units of the frame
        ((own_across, own_down),) = (frame.sampling[number] for number in chosen)
        size = -(-frame.width * own_across // across), -(-frame.height * own_down // down)
        across, down, counts = 1, 1, {number: 1 for number in chosen}
    else:
        size, counts = (frame.width, frame.height), {n: frame.sampling[n][0] * frame.sampling[n][1] for n in chosen}
    dc = np.array([choice >> 4 for number, choice in chosen.items() for _ in range(counts[number])])
    ac = np.array([4 + (choice & 3) for number, choice in chosen.items() for _ in range(counts[number])])
    return set(chosen), dc, ac, -(-size[0] // (8 * across)) * -(-size[1] // (8 * down))


@lru_cache(4)  # a camera has one set for all its pictures
def _huffman_lookup_tables(tables: bytes) -> Codes:
    """What the next 16 bits begin with: bits of word and value together << 8 | symbol; 0 for no word of the table.

    Args:    tables: the contents of all DHT segments. Returns: (8, 65536), four tables for DC, then four for AC.
    """
    codes = np.zeros((8, 1 << CODE_WORD_BITS_MAX), np.uint16)
    at = 0
    while at < len(tables):
        kind, number = tables[at] >> 4, tables[at] & 15
        if kind > 1 or number > 3:
            raise ValueError("a table of no known kind")
        row = codes[4 * kind + number]
        row[:] = 0
        counts, symbol, word = tables[at + 1 : at + 17], at + 17, 0
        for bits in range(1, CODE_WORD_BITS_MAX + 1):
            for _ in range(counts[bits - 1]):
                value = tables[symbol]
                row[word << (CODE_WORD_BITS_MAX - bits) : (word + 1) << (CODE_WORD_BITS_MAX - bits)] = (
                    bits + (value & 15)
                ) << 8 | value
                word, symbol = word + 1, symbol + 1
            word <<= 1
        at = symbol
    return codes


@lru_cache(1)
def _standard_huffman_tables() -> bytes:
    """The tables of T.81 K.3.3, as libjpeg writes them for a colour picture by default."""
    jpeg = cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1].reshape(-1)
    tables, position = b"", 2
    while jpeg[position + 1] != SCAN:
        size = _big_endian_uint16(jpeg, position + 2)
        tables += jpeg[position + 4 : position + 2 + size].tobytes() if jpeg[position + 1] == TABLES else b""
        position += 2 + size
    return tables


@njit(cache=True, nogil=True)
def _read(
    data: Bytes, position: int, codes: Codes, dc: NDArray[np.int64], ac: NDArray[np.int64], n_units: int, interval: int
) -> tuple[int, int, int]:
    """Fault, unit at which it shows, and the byte behind what was read."""
    bits, held, more = np.uint64(0), 0, True  # the newest bits, how many of them are unread, whether data follow them
    restart = 0
    for unit in range(n_units + 1):
        if unit == n_units or (interval > 0 and unit > 0 and unit % interval == 0):
            padding = np.int64(bits & np.uint64(0xFF)) & ((1 << min(held, 7)) - 1)
            ends = position >= len(data) or (
                data[position] == 0xFF and (position + 1 >= len(data) or data[position + 1] != 0)
            )
            if held > 7 or not ends or (padding != 0 and padding != (1 << held) - 1):
                return _LEFT_OVER, unit, position
            if unit == n_units:
                break
            while position + 1 < len(data) and data[position + 1] == 0xFF:
                position += 1
            if position + 1 >= len(data) or data[position + 1] != RESTART + restart:
                return _RESTART, unit, position
            position, restart = position + 2, (restart + 1) % 8
            bits, held, more = np.uint64(0), 0, True
        for block in range(len(dc)):
            k, table = 0, codes[dc[block]]
            while k < 64:
                while more and held < CODE_AND_VALUE_BITS_MAX:
                    byte = data[position] if position < len(data) else np.uint8(0xFF)
                    if byte == 0xFF and (position + 1 >= len(data) or data[position + 1] != 0):
                        more = False
                        break
                    bits = bits << np.uint64(8) | np.uint64(byte)
                    position += 2 if byte == 0xFF else 1
                    held += 8
                shift = held - CODE_WORD_BITS_MAX  # below 0 only at the end
                ahead = bits >> np.uint64(shift) if shift >= 0 else bits << np.uint64(-shift)
                code = np.int64(table[np.int64(ahead & np.uint64(0xFFFF))])
                held -= code >> 8
                if code == 0 or held < 0:
                    return (_CODE if shift >= 0 else _EARLY), unit, position
                if k == 0:
                    if code & 0xFF > DC_BITS_MAX:
                        return _CODE, unit, position
                    k, table = 1, codes[ac[block]]
                elif code & 0xFF == 0:
                    break
                else:
                    k += 1 + (code >> 4 & 0xF)
            if k > 64:
                return _BLOCK, unit, position
    return _FINE, n_units, position
