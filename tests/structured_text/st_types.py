"""Types of the dialect, what converts into what without a word, and where fields lie in memory."""

import re
from dataclasses import dataclass, field

import st_ast as ast


class Type:
    """Base of all types; `name` is for messages."""

    __slots__ = ()

    @property
    def name(self) -> str:
        """As the programmer writes it."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True, eq=False)
class Elementary(Type):
    """BOOL, integers, bit strings, reals. `kind`: bool, bits, uint, sint, real, or a literal's any_int, any_real."""

    title: str
    kind: str
    size: int
    code: str  # of struct and memoryview
    lo: int = 0
    hi: int = 0

    @property
    def name(self) -> str:
        return self.title

    @property
    def is_integer(self) -> bool:
        """Whole numbers and bit strings, literals too."""
        return self.kind in ("bits", "uint", "sint", "any_int")

    @property
    def is_real(self) -> bool:
        """REAL, LREAL and literals with a point."""
        return self.kind in ("real", "any_real")

    @property
    def bits(self) -> int:
        """Width."""
        return 8 * self.size


def _integers() -> dict[str, Elementary]:
    found = {}
    for kind, names, codes in (
        ("bits", ("BYTE", "WORD", "DWORD", "LWORD"), "BHIQ"),
        ("uint", ("USINT", "UINT", "UDINT", "ULINT"), "BHIQ"),
        ("sint", ("SINT", "INT", "DINT", "LINT"), "bhiq"),
    ):
        for name, code, size in zip(names, codes, (1, 2, 4, 8), strict=True):
            lo, hi = (-(1 << 8 * size - 1), (1 << 8 * size - 1) - 1) if kind == "sint" else (0, (1 << 8 * size) - 1)
            found[name] = Elementary(name, kind, size, code, lo, hi)
    return found


BOOL = Elementary("BOOL", "bool", 1, "?", 0, 1)
REAL = Elementary("REAL", "real", 4, "f")
LREAL = Elementary("LREAL", "real", 8, "d")
ANY_INT = Elementary("integer literal", "any_int", 0, "")
ANY_REAL = Elementary("real literal", "any_real", 0, "")
ELEMENTARY: dict[str, Elementary] = {"BOOL": BOOL, "REAL": REAL, "LREAL": LREAL, **_integers()}
BYTE, USINT, UDINT, ULINT = (ELEMENTARY[name] for name in ("BYTE", "USINT", "UDINT", "ULINT"))


@dataclass(frozen=True, slots=True)
class Array(Type):
    """One dimension; ARRAY[a..b, c..d] is an array of arrays."""

    lower: int
    upper: int
    element: Type

    @property
    def name(self) -> str:
        return f"ARRAY[{self.lower}..{self.upper}] OF {self.element.name}"

    @property
    def count(self) -> int:
        """Elements."""
        return self.upper - self.lower + 1


@dataclass(frozen=True, slots=True)
class Pointer(Type):
    """POINTER TO target."""

    target: Type

    @property
    def name(self) -> str:
        return f"POINTER TO {self.target.name}"


@dataclass(slots=True, eq=False)
class Variable:
    """A declared name: `kind` is its block's (VAR, VAR_INPUT, ... or FIELD); `code` how the Python source says it."""

    name: str
    type: Type
    kind: str
    line: int
    constant: bool = False
    initial: ast.Initial | None = None
    code: str = ""
    const: bool | int | float | None = None


@dataclass(slots=True, eq=False)
class Record(Type):
    """STRUCT or UNION; `fields` by lower case name."""

    title: str
    is_union: bool
    fields: dict[str, Variable] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return self.title


@dataclass(slots=True, eq=False)
class Enum(Type):
    """Enumeration with its base type; `items` by lower case name."""

    title: str
    base: Elementary
    items: dict[str, tuple[str, int]]
    default: int

    @property
    def name(self) -> str:
        return self.title


@dataclass(slots=True, eq=False)
class Signature:
    """How a function or method is called: parameters in order (inputs and in-outs), then outputs, then the result."""

    label: str
    code: str
    parameters: list[Variable]
    outputs: list[Variable]
    result: Type | None

    @property
    def returned(self) -> list[Variable]:
        """What the Python function gives back after the result: outputs, and in-outs that Python cannot share."""
        return self.outputs + [p for p in self.parameters if p.kind == "VAR_IN_OUT" and not is_shared(p.type)]


@dataclass(slots=True, eq=False)
class FunctionBlock(Type):
    """FUNCTION_BLOCK or PROGRAM."""

    title: str
    code: str
    variables: dict[str, Variable] = field(default_factory=dict)
    methods: dict[str, Signature] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return self.title


def is_shared(kind: Type) -> bool:
    """Whether Python passes such a value by reference, as VAR_IN_OUT must."""
    return not isinstance(kind, Elementary | Enum | Pointer)


def fits(source: Type, target: Type) -> bool:
    """Whether TwinCAT converts without a word and without loss; literals are judged by their value elsewhere."""
    if source is target or source == target:
        return True
    if isinstance(source, Enum) and isinstance(target, Elementary):
        return source.base is target
    if not (isinstance(source, Elementary) and isinstance(target, Elementary)):
        return _same_pointer(source, target)
    if source.kind == "real":
        return target is LREAL
    if source.kind == "bool" or target.kind == "bool" or not source.is_integer:
        return False
    if target.kind == "real":
        return source.size <= target.size // 2
    if target.kind == "sint":
        return source.size < target.size or (source.kind == "sint" and source.size == target.size)
    return source.kind != "sint" and source.size <= target.size


def _same_pointer(source: Type, target: Type) -> bool:
    if not (isinstance(source, Pointer) and isinstance(target, Pointer)):
        return False
    return {source.target, target.target} <= {BYTE, USINT} or source.target == target.target


def common(a: Type, b: Type) -> Type | None:
    """The type in which both are computed; None: they do not go together."""
    if fits(a, b):
        return b
    return a if fits(b, a) else None


def size_of(kind: Type) -> int:
    """Bytes; natural and packed layout are the same in this project, so there are no gaps."""
    if isinstance(kind, Array):
        return kind.count * size_of(kind.element)
    if isinstance(kind, Enum):
        return kind.base.size
    if isinstance(kind, Record):
        sizes = [size_of(member.type) for member in kind.fields.values()]
        return max(sizes, default=0) if kind.is_union else sum(sizes)
    if isinstance(kind, Elementary):
        return kind.size
    raise TypeError(f"{kind.name} has no size here")


def alignment(kind: Type) -> int:
    """The greatest size of an elementary part."""
    if isinstance(kind, Array):
        return alignment(kind.element)
    if isinstance(kind, Record):
        return max((alignment(member.type) for member in kind.fields.values()), default=1)
    return size_of(kind)


def offset_of(record: Record, name: str) -> int:
    """Byte offset of a field (lower case name); ValueError where a compiler would leave a gap before it."""
    at = 0
    for lower, member in record.fields.items():
        if at % alignment(member.type):
            raise ValueError(f"{record.name}.{member.name} at byte {at} is not aligned: packed and natural differ")
        if lower == name:
            return at
        at += 0 if record.is_union else size_of(member.type)
    raise KeyError(name)


_PYTHON_WORDS = re.compile(
    r"(False|None|True|and|as|assert|async|await|break|class|continue|def|del|elif|else|except|finally|for|from|global"
    r"|if|import|in|is|lambda|nonlocal|not|or|pass|raise|return|try|while|with|yield|self|_.*)$"
)


def python_name(name: str) -> str:
    """The variable's name in the Python source."""
    return name + "_" if _PYTHON_WORDS.match(name) else name
