"""Unions as memory: a bytearray seen as numbers, structs and arrays; pointers; the guard against NaN from outside."""

import math
import operator
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from st_errors import StRuntimeError
from st_types import Array, Elementary, Enum, Record, Type, Variable, offset_of, python_name, size_of

_CODES = "HIQbhiqfd?"


class Memory:
    """A union variable; `bytes` is its content. Subclasses have a property for each member."""

    __slots__ = ("st_B", "st_V", *(f"st_{code}" for code in _CODES if code != "?"), "st_bool")
    record: Record

    def __init__(self) -> None:
        self.st_B = bytearray(size_of(self.record))
        self.st_V = memoryview(self.st_B)
        for code in _CODES:
            size = struct_size(code)
            whole = len(self.st_B) // size * size
            name = "st_bool" if code == "?" else f"st_{code}"
            setattr(self, name, _cast(self.st_V[:whole], code) if whole else ())

    @property
    def bytes(self) -> bytearray:
        """The content, alive: what is written into it is seen by the program."""
        return self.st_B

    @bytes.setter
    def bytes(self, content: Any) -> None:
        if len(content) != len(self.st_B):
            raise StRuntimeError(f"{self.record.name} has {len(self.st_B)} bytes, given {len(content)}")
        self.st_B[:] = content

    def st_set(self, other: "Memory") -> None:
        """Assignment of a whole union."""
        self.st_B[:] = other.st_B

    def st_from(self, other: "Memory") -> "Memory":
        """The same, for a copy: itself."""
        self.st_B[:] = other.st_B
        return self


def _cast(memory: memoryview, code: Any) -> Any:
    return memory.cast(code)


def struct_size(code: str) -> int:
    """Bytes of a format code."""
    return {"H": 2, "h": 2, "I": 4, "i": 4, "f": 4, "Q": 8, "q": 8, "d": 8}.get(code, 1)


def numbers(memory: Memory, code: str) -> Any:
    """The memory as numbers of a format code; single bytes as a memoryview, so that a slice stays alive."""
    return memory.st_V if code == "B" else getattr(memory, "st_bool" if code == "?" else f"st_{code}")


class StructView:
    """A struct that lies in a union: fields are properties; the same use as a plain struct."""

    __slots__ = ("st_at", "st_memory")
    record: Record
    runs: tuple[tuple[int, int, str], ...]  # where the reals lie: offset, count, format code
    arrays: tuple[tuple[str, int, int, str], ...]  # arrays of numbers, kept as slices: slot, offset, count, code

    def __init__(self, memory: Memory, at: int) -> None:
        self.st_memory, self.st_at = memory, at
        for slot, offset, count, code in self.arrays:
            first = (at + offset) // struct_size(code)
            setattr(self, slot, numbers(memory, code)[first : first + count])

    def st_set(self, other: Any) -> None:
        """Assignment of a whole struct, from a plain one or another view."""
        size = size_of(self.record)
        if isinstance(other, StructView):
            data = other.st_memory.st_B[other.st_at : other.st_at + size]
        else:
            data = encode(self.record, other)
        self.st_memory.st_B[self.st_at : self.st_at + size] = data


class Elements(Sequence[Any]):
    """An array in a union whose elements are no plain numbers."""

    __slots__ = ("_array", "_at", "_memory")

    def __init__(self, memory: Memory, at: int, array: Array) -> None:
        self._memory, self._at, self._array = memory, at, array

    def __len__(self) -> int:
        return self._array.count

    def __getitem__(self, index: Any) -> Any:
        if not 0 <= index < self._array.count:
            raise IndexError(index)
        return view(self._memory, self._at + index * size_of(self._array.element), self._array.element)

    def __iter__(self) -> Iterator[Any]:
        return (self[index] for index in range(len(self)))


def view(memory: Memory, at: int, kind: Type) -> Any:
    """What lies at a byte of the memory: a number, a slice of numbers, a view of a struct, or elements."""
    if isinstance(kind, Record):
        return view_class(kind)(memory, at)
    if isinstance(kind, Enum):
        kind = kind.base
    if isinstance(kind, Elementary):
        return numbers(memory, kind.code)[at // kind.size]
    if isinstance(kind, Array) and isinstance(kind.element, Elementary):
        first = at // kind.element.size
        return numbers(memory, kind.element.code)[first : first + kind.count]
    if isinstance(kind, Array):
        return Elements(memory, at, kind)
    raise StRuntimeError(f"{kind.name} cannot lie in a union")


def store(memory: Memory, at: int, kind: Type, value: Any) -> None:
    """The way back of `view`."""
    if isinstance(kind, Elementary | Enum):
        plain = kind.base if isinstance(kind, Enum) else kind
        numbers(memory, plain.code)[at // plain.size] = value
    else:
        memory.st_B[at : at + size_of(kind)] = encode(kind, value)


def _property(kind: Type, locate: Callable[[Any], tuple[Memory, int]]) -> property:
    return property(lambda self: view(*locate(self), kind), lambda self, value: store(*locate(self), kind, value))


def _field_property(member: Variable, offset: int) -> property:
    kept = _property(member.type, lambda self: (self.st_memory, self.st_at + offset))
    if isinstance(member.type, Array) and isinstance(member.type.element, Elementary):
        return property(operator.attrgetter(_slot(member)), kept.fset)
    return kept


def _slot(member: Variable) -> str:
    return f"st_a_{member.name}"


_VIEWS: dict[int, tuple[Record, type[StructView]]] = {}


def view_class(record: Record) -> type[StructView]:
    """The view of a struct type; made once."""
    if id(record) not in _VIEWS:
        offsets = {lower: offset_of(record, lower) for lower in record.fields}
        members = {python_name(m.name): _field_property(m, offsets[lower]) for lower, m in record.fields.items()}
        arrays = tuple(
            (_slot(member), offsets[lower], member.type.count, member.type.element.code)
            for lower, member in record.fields.items()
            if isinstance(member.type, Array) and isinstance(member.type.element, Elementary)
        )
        slots = {"__slots__": tuple(slot for slot, *_ in arrays), "record": record}
        about = {"runs": tuple(_runs(record, 0)), "arrays": arrays}
        made = type(record.name, (StructView,), {**slots, **about, **members})
        _VIEWS[id(record)] = (record, made)
    return _VIEWS[id(record)][1]


def union_class(record: Record) -> type[Memory]:
    """The class of a union's variables."""
    members = {
        python_name(member.name): _property(member.type, lambda self: (self, 0)) for member in record.fields.values()
    }
    for lower in record.fields:
        offset_of(record, lower)
    return type(record.name, (Memory,), {"__slots__": (), "record": record, **members})


def _runs(kind: Type, at: int) -> Iterator[tuple[int, int, str]]:
    if isinstance(kind, Elementary) and kind.is_real:
        yield at, 1, kind.code
    elif isinstance(kind, Array) and isinstance(kind.element, Elementary):
        if kind.element.is_real:
            yield at, kind.count, kind.element.code
    elif isinstance(kind, Array):
        for index in range(kind.count):
            yield from _runs(kind.element, at + index * size_of(kind.element))
    elif isinstance(kind, Record):
        for lower, member in kind.fields.items():
            yield from _runs(member.type, at + offset_of(kind, lower))


def _check_numbers(found: Any) -> None:
    total = sum(found)
    if total - total != 0.0:  # NaN, infinity, or finite numbers whose sum is too great
        for index, value in enumerate(found):
            if not math.isfinite(value):
                raise StRuntimeError(f"element {index} is {value}, handed on as a number: TwinCAT could stop here")


def finite_part(part: Any) -> Any:
    """The same view, after a look at its reals: a struct or array that goes from a union into a calculation."""
    if isinstance(part, StructView):
        for offset, count, code in part.runs:
            first = (part.st_at + offset) // struct_size(code)
            _check_numbers(numbers(part.st_memory, code)[first : first + count])
    elif isinstance(part, memoryview):
        if part.format in ("d", "f"):
            _check_numbers(part)
    elif isinstance(part, Elements):
        for item in part:
            finite_part(item)
    return part


def encode(kind: Type, value: Any) -> bytes:
    """Bytes of a plain value."""
    if isinstance(value, Memory):
        return bytes(value.st_B)
    if isinstance(kind, Record):
        return b"".join(encode(m.type, getattr(value, python_name(m.name))) for m in kind.fields.values())
    if isinstance(kind, Array):
        return b"".join(encode(kind.element, item) for item in value)
    plain = kind.base if isinstance(kind, Enum) else kind
    if not isinstance(plain, Elementary):
        raise StRuntimeError(f"{kind.name} has no bytes here")
    cell = bytearray(plain.size)
    _cast(memoryview(cell), plain.code)[0] = value
    return bytes(cell)


def decode(kind: Type, data: bytes, target: Any) -> Any:
    """Bytes into a plain value; structs and arrays are filled where they are."""
    if isinstance(target, Memory):
        target.st_B[:] = data
        return target
    if isinstance(kind, Record):
        for lower, member in kind.fields.items():
            at, name = offset_of(kind, lower), python_name(member.name)
            part = data[at : at + size_of(member.type)]
            setattr(target, name, decode(member.type, part, getattr(target, name)))
        return target
    if isinstance(kind, Array):
        size = size_of(kind.element)
        for index in range(kind.count):
            target[index] = decode(kind.element, data[index * size : (index + 1) * size], target[index])
        return target
    plain = kind.base if isinstance(kind, Enum) else kind
    if not isinstance(plain, Elementary):
        raise StRuntimeError(f"{kind.name} has no bytes here")
    return _cast(memoryview(data), plain.code)[0]


class Cell:
    """Plain storage (not in a union) seen as bytes: slow, for ADR of what is no BYTE array."""

    __slots__ = ("_kind", "_name", "_owner")

    def __init__(self, owner: Any, name: str, kind: Type) -> None:
        self._owner, self._name, self._kind = owner, name, kind

    def _value(self) -> Any:
        return getattr(self._owner, self._name) if self._name else self._owner

    def __len__(self) -> int:
        return size_of(self._kind)

    def __getitem__(self, index: Any) -> Any:
        return encode(self._kind, self._value())[index]

    def __setitem__(self, index: Any, value: Any) -> None:
        data = bytearray(encode(self._kind, self._value()))
        data[index] = value
        decoded = decode(self._kind, bytes(data), self._value())
        if self._name:
            setattr(self._owner, self._name, decoded)


class Place:
    """What ADR gives: bytes and a place in them."""

    __slots__ = ("at", "buf")

    def __init__(self, buf: Any, at: int) -> None:
        self.buf, self.at = buf, at

    def read(self, count: int) -> bytes:
        """`count` bytes from here."""
        data = bytes(self.buf[self.at : self.at + count])
        if len(data) != count:
            raise StRuntimeError(f"{count} bytes read where {len(data)} are")
        return data

    def write(self, data: bytes, count: int) -> None:
        """`count` bytes to here."""
        if self.at < 0 or self.at + count > len(self.buf):
            raise StRuntimeError(f"{count} bytes written where {len(self.buf) - self.at} are")
        self.buf[self.at : self.at + count] = data
