"""Instances as Python sees them: attributes by any spelling, values checked on the way in."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from st_errors import StTypeError
from st_memory import Memory, Place
from st_types import Array, Elementary, Enum, FunctionBlock, Pointer, Record, Type, Variable, python_name

if TYPE_CHECKING:
    from st_program import Program


def spelled(variables: Iterable[Variable], name: str) -> str | None:
    """The declared spelling; None: there is no such parameter."""
    return next((variable.name for variable in variables if variable.name.lower() == name.lower()), None)


def accepted(variable: Variable, value: Any) -> Any:
    """A value from Python for a variable: checked, and bytes made a pointer."""
    return _accepted(variable.type, value, variable.name)


def _accepted(kind: Type, value: Any, what: str) -> Any:
    if isinstance(kind, Enum):
        return _accepted(kind.base, int(value), what)
    if isinstance(kind, Elementary):
        return _number(kind, value, what)
    if isinstance(kind, Pointer):
        return Place(value if isinstance(value, bytearray) else bytearray(value), 0) if _is_bytes(value) else value
    if isinstance(kind, Array) and len(value) != kind.count:
        raise StTypeError(f"{what}: {kind.name} given {len(value)} elements")
    if isinstance(kind, Record) and kind.is_union and not (isinstance(value, Memory) and value.record is kind):
        raise StTypeError(f"{what}: {kind.name} given {type(value).__name__}")
    return value._st if isinstance(value, Structure) else value


def _is_bytes(value: Any) -> bool:
    return isinstance(value, bytes | bytearray | memoryview)


def _number(kind: Elementary, value: Any, what: str) -> bool | int | float:
    if kind.kind == "bool":
        return bool(value)
    if kind.is_real:
        return float(value)
    number = int(value)
    if number != value or not kind.lo <= number <= kind.hi:
        raise StTypeError(f"{what}: {value!r} is no {kind.name}")
    return number


class Structure:
    """Variables by name: a global variable list, and the base of an instance."""

    __slots__ = ("_name", "_program", "_st", "_variables")

    def __init__(self, program: "Program", variables: dict[str, Variable], content: Any, name: str) -> None:
        for slot, value in (("_program", program), ("_variables", variables), ("_st", content), ("_name", name)):
            object.__setattr__(self, slot, value)

    def _variable(self, name: str) -> Variable:
        found = self._variables.get(name.lower())
        if found is None:
            raise AttributeError(f"{self._name} has no variable {name}")
        return found

    def __getattr__(self, name: str) -> Any:
        variable = self._variable(name)
        if variable.constant:
            return self._program.constant_of(variable)
        value = getattr(self._st, python_name(variable.name))
        return Instance(self._program, variable.type, value) if isinstance(variable.type, FunctionBlock) else value

    def __setattr__(self, name: str, value: Any) -> None:
        variable = self._variable(name)
        if variable.constant:
            raise StTypeError(f"{self._name}.{variable.name} is a constant")
        attribute = python_name(variable.name)
        value = accepted(variable, value)
        old = getattr(self._st, attribute)
        if isinstance(variable.type, Array) and variable.kind != "VAR_IN_OUT":
            old[:] = list(value)
        elif isinstance(variable.type, Record) and variable.kind != "VAR_IN_OUT":
            old.st_set(value)
        else:
            setattr(self._st, attribute, value)


class Instance(Structure):
    """A function block instance: variables are attributes."""

    __slots__ = ("_block",)

    def __init__(self, program: "Program", block: FunctionBlock, content: Any) -> None:
        super().__init__(program, block.variables, content, block.name)
        object.__setattr__(self, "_block", block)

    def set(self, **inputs: Any) -> None:
        """Set inputs and in-outs; StTypeError for what is neither."""
        for name, value in inputs.items():
            variable = self._variables.get(name.lower())
            if variable is None or variable.kind not in ("VAR_INPUT", "VAR_IN_OUT"):
                raise StTypeError(f"{self._name} has no input {name}")
            setattr(self, name, value)

    def call(self, **inputs: Any) -> None:
        """One call of the block's body."""
        self.set(**inputs)
        self._program.run(self._program.code(f"{self._block.code}__body_"), self._st)

    def method(self, name: str, *given: Any, **named: Any) -> Any:
        """Call a method. With outputs it gives (result, outputs by name)."""
        signature = self._block.methods.get(name.lower())
        if signature is None:
            raise StTypeError(f"{self._name} has no method {name}")
        return self._program.call(self._program.code(signature.code), (self._st,), signature, given, named)
