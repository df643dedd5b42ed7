"""Load Structured Text (TwinCAT exports or plain texts), check its types, and run it.

Assumptions where runtimes differ: real to integer rounds half to even (`truncate` shows that a program does not care);
a BOOL AND or OR evaluates both sides; LIMIT is MIN(MAX(IN, MN), MX); an enum begins at 0 if it has a 0, else at its
first item; integers wrap to their type when they are assigned.

StRuntimeError, because a PLC could stop or compute something else: division by zero; an index outside its array; a
NaN or infinity loaded as a number from a union, by itself, with its struct or with its array; a real to integer that
does not fit; a shift by the whole width; SQRT of a negative number; a FOR up to its type's limit, which never ends; an
intermediate result of less than 64 bits that has left its type when it is compared, divided, shifted right, widened or
used as an index (runtimes compute it with different widths).

StTypeError beyond TwinCAT's own rules: a scalar VAR_IN_OUT whose variable the callee also reaches by another way (it
is copied in and out here), and a REAL met by a literal that is not exact as REAL.
"""

from collections.abc import Callable, Collection, Mapping
from typing import Any

import st_ast as ast
from st_errors import StRuntimeError, StTypeError
from st_files import read_export, read_text
from st_instance import Instance, Structure, accepted, spelled
from st_memory import Memory
from st_model import Model
from st_runtime import to_integer_truncated
from st_translate import FILE_NAME, Translation, Translator, constant_value, namespace
from st_types import Enum, FunctionBlock, Record, Signature, Variable


class Program:
    """Translated sources; instances, functions and unions are made from it. Global variables live once per program."""

    def __init__(self, translation: Translation, attributes: dict[str, dict[str, str]], truncate: bool = False) -> None:
        self.model, self._translation = translation.model, translation
        self.attributes = attributes  # {attribute ...} of each source, by the name of what it declares
        self.skipped = tuple(translation.model.skipped)  # EXTENDS and IMPLEMENTS: parsed, not run
        self._marks = bytearray(len(translation.marks))
        self._names = {**namespace(self.model), "_st_marks": self._marks}
        if truncate:
            self._names["_st_int"] = to_integer_truncated
        exec(compile(translation.source, FILE_NAME, "exec"), self._names)  # our own translation

    @property
    def python_source(self) -> str:
        """The translation, to look at."""
        return self._translation.source

    def not_run(self) -> list[str]:
        """POU and line of every statement that has not run yet; needs load_program(count=True)."""
        return [where for where, done in zip(self._translation.marks, self._marks, strict=True) if not done]

    def statements(self) -> int:
        """How many statements are counted."""
        return len(self._marks)

    def new(self, block: str, **inputs: Any) -> Instance:
        """A fresh instance of a FUNCTION_BLOCK or PROGRAM, with inputs set."""
        kind = self.model.named_type(block)
        if not isinstance(kind, FunctionBlock):
            raise StTypeError(f"{block} is no function block")
        instance = Instance(self, kind, self._names[kind.code]())
        instance.set(**inputs)
        return instance

    def new_union(self, name: str, content: bytes | None = None) -> Any:
        """A union variable; `.bytes` is its memory, members are attributes."""
        kind = self.model.named_type(name)
        if not isinstance(kind, Record):
            raise StTypeError(f"{name} is no union")
        made = self._names[f"_g_{kind.name}"]()
        if content is not None and isinstance(made, Memory):
            made.bytes = content
        return made

    new_struct = new_union

    def function(self, name: str) -> Callable[..., Any]:
        """A FUNCTION: called with inputs by name or position. With outputs it gives (result, outputs by name)."""
        signature = self.model.function(name)
        if signature is None:
            raise StTypeError(f"{name} is no function")
        code = self._names[signature.code]
        return lambda *given, **named: self.call(code, (), signature, given, named)

    def globals(self, name: str) -> Structure:
        """The variables of a global variable list; writing them counts for all instances."""
        scope = self.model.global_scopes.get(name.lower())
        if scope is None:
            raise StTypeError(f"{name} is no global variable list")
        variables = {variable.name.lower(): variable for variable in scope.variables()}
        return Structure(self, variables, self._names[f"_v_{self.model.global_names[name.lower()]}"], name)

    def constant_of(self, variable: Variable) -> Any:
        """The value of a constant."""
        return variable.const if variable.const is not None else self._names[variable.code]

    def enum(self, name: str) -> dict[str, int]:
        """An enum's items."""
        kind = self.model.named_type(name)
        if not isinstance(kind, Enum):
            raise StTypeError(f"{name} is no enum")
        return dict(kind.items.values())

    def code(self, name: str) -> Callable[..., Any]:
        """A function of the translation by its Python name."""
        return self._names[name]

    def call(
        self, code: Callable[..., Any], head: tuple[Any, ...], signature: Signature, given: Any, named: dict[str, Any]
    ) -> Any:
        """Call a translated function with checked arguments."""
        found = {spelled(signature.parameters, name): value for name, value in named.items()}
        for parameter, value in zip(signature.parameters, given, strict=False):
            found[parameter.name] = value
        missing = [p.name for p in signature.parameters if p.name not in found]
        if missing or len(given) > len(signature.parameters) or None in found:
            raise StTypeError(f"{signature.label} takes {[p.name for p in signature.parameters]}, given {list(named)}")
        arguments = [accepted(parameter, found[parameter.name]) for parameter in signature.parameters]
        back = self.run(code, *head, *arguments)
        if not signature.returned:
            return back
        values = list(back)
        result = values.pop(0) if signature.result else None
        outputs = dict(zip([variable.name for variable in signature.returned], values, strict=True))
        return result, outputs

    def run(self, code: Callable[..., Any], *arguments: Any) -> Any:
        """Call translated code; what Python raises becomes a StRuntimeError that names POU and line."""
        try:
            return code(*arguments)
        except (StRuntimeError, ArithmeticError, LookupError, ValueError, AttributeError, RecursionError) as error:
            raise StRuntimeError(f"{self._where(error)}: {_explained(error)}") from error

    def _where(self, error: BaseException) -> str:
        where, step = "outside the program", error.__traceback__
        while step is not None:
            if step.tb_frame.f_code.co_filename == FILE_NAME:
                line = self._translation.lines[step.tb_lineno - 1]
                where = f"{line.label}line {line.line}"
            step = step.tb_next
        return where


def _explained(error: BaseException) -> str:
    if isinstance(error, ZeroDivisionError):
        return "division by zero"
    if isinstance(error, IndexError):
        return "index outside the array"
    if isinstance(error, AttributeError) and "NoneType" in str(error):
        return "a null pointer or an unset VAR_IN_OUT is used"
    return str(error)


def _units(sources: Mapping[str, str | bytes]) -> list[ast.Unit]:
    found = []
    for name, content in sources.items():
        text = content.decode("utf-8-sig") if isinstance(content, bytes) else content
        unit = read_export(name, text) if name.lower().endswith((".tcpou", ".tcdut", ".tcgvl")) else None
        if unit is None and name.lower().endswith((".tctleo", ".tsproj", ".plcproj", ".tmc", ".tctto", ".sln")):
            continue
        found.append(unit or read_text(name, text))
    return found


def translate(
    sources: Mapping[str, str | bytes], without: Collection[str] = (), count: bool = False
) -> tuple[Translation, dict[str, dict[str, str]]]:
    """Parse, resolve and translate; type errors are in the translation."""
    units = _units(sources)
    attributes = {item.name: unit.attributes for unit in units for item in unit.items}
    return Translator(Model(units, constant_value, without), count).run(), attributes


def check_types(files: Mapping[str, str | bytes], without: Collection[str] = ()) -> list[StTypeError]:
    """Every type error found, one a statement at most; nothing is run.

    Args:    files: as for load_program; without: POUs that are parsed only, because they use libraries of TwinCAT's.
    """
    return translate(files, without)[0].errors


def load_program(
    files: Mapping[str, str | bytes],
    without: Collection[str] = (),
    *,
    count: bool = False,
    truncate: bool = False,
) -> Program:
    """The program in exported TwinCAT files (.TcPOU .TcDUT .TcGVL) and plain texts, by relative path.

    Args:    without: POUs that are parsed only, because they use libraries of TwinCAT's.
             count: statements that run leave a mark, see Program.not_run.
             truncate: real to integer cuts instead of rounding, to show that a program leans on neither.
    Raises:  StSyntaxError, or the first StTypeError.
    """
    translation, attributes = translate(files, without, count)
    if translation.errors:
        raise translation.errors[0]
    return Program(translation, attributes, truncate)


load_sources = load_program  # plain texts by name; the name of a list of global variables is that of its file
