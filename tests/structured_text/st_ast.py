"""The syntax tree of the Structured Text dialect; every node knows its line."""

from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Literal:
    """A number, BOOL or string; `type_name` as in UDINT#5, empty where the literal has none."""

    line: int
    value: bool | int | float | str
    type_name: str = ""


@dataclass(frozen=True, slots=True)
class Name:
    """A plain identifier."""

    line: int
    text: str


@dataclass(frozen=True, slots=True)
class Member:
    """base.name"""

    line: int
    base: "Expression"
    name: str


@dataclass(frozen=True, slots=True)
class Index:
    """base[i, j]"""

    line: int
    base: "Expression"
    indices: tuple["Expression", ...]


@dataclass(frozen=True, slots=True)
class Deref:
    """base^"""

    line: int
    base: "Expression"


@dataclass(frozen=True, slots=True)
class Unary:
    """- or NOT."""

    line: int
    op: str
    operand: "Expression"


@dataclass(frozen=True, slots=True)
class Binary:
    """left op right; op in capitals."""

    line: int
    op: str
    left: "Expression"
    right: "Expression"


@dataclass(frozen=True, slots=True)
class Argument:
    """One argument; `value` is None for an output that nobody wants (`b =>`)."""

    line: int
    name: str
    value: "Expression | None"
    is_output: bool = False


@dataclass(frozen=True, slots=True)
class Call:
    """target(arguments)"""

    line: int
    target: "Expression"
    arguments: tuple[Argument, ...]


Expression = Literal | Name | Member | Index | Deref | Unary | Binary | Call


@dataclass(frozen=True, slots=True)
class Assign:
    """target := value;"""

    line: int
    target: Expression
    value: Expression


@dataclass(frozen=True, slots=True)
class CallStatement:
    """A call on its own."""

    line: int
    call: Expression


@dataclass(frozen=True, slots=True)
class If:
    """IF and ELSIF branches, then ELSE."""

    line: int
    branches: tuple[tuple[Expression, tuple["Statement", ...]], ...]
    otherwise: tuple["Statement", ...]


@dataclass(frozen=True, slots=True)
class Label:
    """One CASE label: a value, or a range first..last."""

    line: int
    first: Expression
    last: Expression | None


@dataclass(frozen=True, slots=True)
class Case:
    """CASE selector OF."""

    line: int
    selector: Expression
    branches: tuple[tuple[tuple[Label, ...], tuple["Statement", ...]], ...]
    otherwise: tuple["Statement", ...]


@dataclass(frozen=True, slots=True)
class For:
    """FOR variable := first TO last BY step."""

    line: int
    variable: str
    first: Expression
    last: Expression
    step: Expression | None
    body: tuple["Statement", ...]


@dataclass(frozen=True, slots=True)
class While:
    """WHILE condition DO."""

    line: int
    condition: Expression
    body: tuple["Statement", ...]


@dataclass(frozen=True, slots=True)
class Repeat:
    """REPEAT body UNTIL condition."""

    line: int
    body: tuple["Statement", ...]
    condition: Expression


@dataclass(frozen=True, slots=True)
class Jump:
    """EXIT, CONTINUE or RETURN."""

    line: int
    kind: str


Statement = Assign | CallStatement | If | Case | For | While | Repeat | Jump


@dataclass(frozen=True, slots=True)
class NamedType:
    """A type by its name; `length` for STRING(80)."""

    line: int
    name: str
    sized: bool = False


@dataclass(frozen=True, slots=True)
class ArrayType:
    """ARRAY[first..last, ...] OF."""

    line: int
    ranges: tuple[tuple[Expression, Expression], ...]
    element: "TypeRef"


@dataclass(frozen=True, slots=True)
class PointerType:
    """POINTER TO, or REFERENCE TO."""

    line: int
    target: "TypeRef"
    kind: str = "POINTER"


TypeRef = NamedType | ArrayType | PointerType


@dataclass(frozen=True, slots=True)
class ArrayInitial:
    """[1, 2, 8(0.0)] as (count, value) pairs."""

    line: int
    items: tuple[tuple[int, "Initial"], ...]


@dataclass(frozen=True, slots=True)
class StructInitial:
    """(a := 1, b := 2)"""

    line: int
    fields: tuple[tuple[str, "Initial"], ...]


Initial = Expression | ArrayInitial | StructInitial


@dataclass(frozen=True, slots=True)
class Declaration:
    """One declared variable or field."""

    line: int
    name: str
    type: TypeRef
    initial: Initial | None


@dataclass(frozen=True, slots=True)
class Block:
    """VAR_INPUT ... END_VAR; `kind` in capitals."""

    line: int
    kind: str
    constant: bool
    declarations: tuple[Declaration, ...]


@dataclass(frozen=True, slots=True)
class Method:
    """A method, or the head of one."""

    line: int
    name: str
    result: TypeRef | None
    blocks: tuple[Block, ...]
    body: tuple[Statement, ...]


@dataclass(frozen=True, slots=True)
class Pou:
    """FUNCTION_BLOCK, FUNCTION or PROGRAM. `inherits`: EXTENDS or IMPLEMENTS, which is parsed and not run."""

    line: int
    kind: str
    name: str
    inherits: bool
    result: TypeRef | None
    blocks: tuple[Block, ...]
    body: tuple[Statement, ...]
    methods: tuple[Method, ...]


@dataclass(frozen=True, slots=True)
class Record:
    """STRUCT or UNION."""

    line: int
    kind: str
    name: str
    fields: tuple[Declaration, ...]


@dataclass(frozen=True, slots=True)
class Enumeration:
    """An enum with its base type (INT where none is given)."""

    line: int
    name: str
    base: str
    items: tuple[tuple[str, Expression | None], ...]
    default: str = ""


@dataclass(frozen=True, slots=True)
class Alias:
    """TYPE name : other;"""

    line: int
    name: str
    type: TypeRef


@dataclass(frozen=True, slots=True)
class Globals:
    """A global variable list; its name is the file's."""

    name: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True, slots=True)
class Unit:
    """One parsed source; `parts` tells declaration and implementation lines apart (exported files)."""

    source: str
    parts: bool
    items: tuple[Pou | Record | Enumeration | Alias | Globals, ...]
    attributes: dict[str, str] = field(default_factory=dict)
