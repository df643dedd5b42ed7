"""The Structured Text runner: values, statements and calls do what a PLC does."""

import random
import zlib
from typing import Any

import pytest
from st_errors import StRuntimeError
from st_program import load_program, load_sources
from st_types import ELEMENTARY


def run(body: str, variables: str = "", result: str = "LINT", extra: dict[str, str] | None = None) -> Any:
    """The value that a function with this body gives."""
    text = f"FUNCTION F : {result}\nVAR\n{variables}\nEND_VAR\n{body}\nEND_FUNCTION\n"
    return load_sources({"F.st": text, **(extra or {})}).function("F")()


@pytest.mark.parametrize(
    ("kind", "start", "op", "by", "expected"),
    [
        ("USINT", 250, "+", 10, 4),
        ("UINT", 0, "-", 1, 65535),
        ("UDINT", 4_000_000_000, "*", 3, 12_000_000_000 % 2**32),
        ("ULINT", 0, "-", 1, 2**64 - 1),
        ("SINT", 127, "+", 1, -128),
        ("INT", -32768, "-", 1, 32767),
        ("DINT", 2**31 - 1, "+", 2, -(2**31) + 1),
        ("LINT", -(2**63), "-", 1, 2**63 - 1),
    ],
)
def test_arithmetic_wraps_to_its_type(kind: str, start: int, op: str, by: int, expected: int) -> None:
    assert run(f"x := x {op} {by}; F := x;", f"x : {kind} := {start};", kind) == expected


@pytest.mark.parametrize(("a", "b"), [(7, 2), (-7, 2), (7, -2), (-7, -2), (6, 3), (-6, 3)])
def test_division_truncates_toward_zero_and_mod_goes_with_it(a: int, b: int) -> None:
    assert run("F := a / b;", f"a : LINT := {a}; b : LINT := {b};") == int(a / b)
    assert run("F := a MOD b;", f"a : LINT := {a}; b : LINT := {b};") == a - b * int(a / b)


@pytest.mark.parametrize(
    ("expression", "kind", "expected"),
    [
        ("SHL(BYTE#16#81, 1)", "BYTE", 2),
        ("SHR(USINT#129, 7)", "USINT", 1),
        ("ROL(DWORD#16#80000001, 4)", "DWORD", 0x18),
        ("ROR(WORD#1, 1)", "WORD", 0x8000),
        ("NOT UINT#16#00FF", "UINT", 0xFF00),
        ("NOT INT#5", "INT", -6),
        ("UDINT#16#F0 XOR 16#FF", "UDINT", 0x0F),
        ("16#7FF0_0000_0000_0000 AND ULINT#16#FFFF_FFFF_FFFF_FFFF", "ULINT", 0x7FF0 << 48),
        ("2#1010 OR 8#5", "INT", 15),
        ("TO_SINT(UINT#200)", "SINT", -56),
        ("TO_USINT(INT#-1)", "USINT", 255),
        ("DINT_TO_UINT(70000)", "UINT", 4464),
        ("TO_ULINT(LINT#-1)", "ULINT", 2**64 - 1),
        ("TO_DINT(TRUE)", "DINT", 1),
        ("TO_BOOL(UINT#4)", "BOOL", True),
        ("TO_LINT(2.5)", "LINT", 2),
        ("TO_LINT(-3.5)", "LINT", -4),
        ("LREAL_TO_DINT(0.49999)", "DINT", 0),
        ("TO_LREAL(ULINT#16#FFFF_FFFF_FFFF_FFFF)", "LREAL", 2.0**64),
        ("MIN(3, DINT#-4, 7)", "DINT", -4),
        ("MAX(2.5, LREAL#1.0)", "LREAL", 2.5),
        ("LIMIT(0, INT#12, 10)", "INT", 10),
        ("ABS(LINT#-5)", "LINT", 5),
        ("SQRT(LREAL#2.0)", "LREAL", 2.0**0.5),
        ("1.0 / 3.0 * 3.0", "LREAL", 1.0 / 3.0 * 3.0),
        ("- LREAL#2.0 * 3.0", "LREAL", -6.0),
        ("2 + 3 * 4 - 10 / 4", "INT", 12),
        ("NOT FALSE AND TRUE XOR TRUE", "BOOL", False),
        ("1 < 2 = TRUE", "BOOL", True),
        ("TRUE OR FALSE AND FALSE", "BOOL", True),
    ],
)
def test_expressions(expression: str, kind: str, expected: object) -> None:
    found = run(f"F := {expression};", "", kind)
    assert found == expected
    assert type(found) is type(expected)


def test_real_is_rounded_to_single_precision_and_lreal_is_not() -> None:
    import numpy as np

    single = run("r := TO_REAL(0.1); r := r * r; F := TO_LREAL(r);", "r : REAL;", "LREAL")
    assert single == float(np.float32(0.1) * np.float32(0.1))
    assert run("x := 0.1; F := x * x;", "x : LREAL;", "LREAL") == 0.1 * 0.1


def _random_expression(rng: random.Random, kind: str, depth: int) -> tuple[str, int]:
    """Source and value of an expression over a, b, c; every operation wraps by itself here."""
    low, high = ELEMENTARY[kind].lo, ELEMENTARY[kind].hi
    if depth == 0:
        name = rng.choice("abc")
        return name, {"a": low, "b": high, "c": high // 3}[name]
    op = rng.choice(["+", "-", "*", "AND", "OR", "XOR"])
    left, x = _random_expression(rng, kind, depth - 1)
    right, y = _random_expression(rng, kind, rng.randrange(depth))
    value = {"+": x + y, "-": x - y, "*": x * y, "AND": x & y, "OR": x | y, "XOR": x ^ y}[op]
    return f"({left} {op} {right})", (value - low) % (high - low + 1) + low


@pytest.mark.parametrize("kind", ["USINT", "INT", "UDINT", "DWORD", "DINT", "ULINT", "LINT"])
def test_leaving_out_masks_changes_no_result(kind: str) -> None:
    rng = random.Random(5)
    low, high = ELEMENTARY[kind].lo, ELEMENTARY[kind].hi
    cases = [_random_expression(rng, kind, 4) for _ in range(40)]
    body = "".join(f"r[{i}] := {source};\n" for i, (source, _) in enumerate(cases))
    text = f"""FUNCTION_BLOCK FB
VAR_OUTPUT r : ARRAY[0..39] OF {kind}; END_VAR
VAR a : {kind} := {low}; b : {kind} := {high}; c : {kind} := {high // 3}; END_VAR
{body}END_FUNCTION_BLOCK"""
    block = load_sources({"FB.st": text}).new("FB")
    block.call()
    assert block.r == [value for _, value in cases]


CASES = """
CASE n OF
    1: F := 10;
    2, 3: F := 20;
    5..9, 11: F := 30;
    -4..-2: F := 40;
ELSE
    F := 50;
END_CASE
"""


@pytest.mark.parametrize(
    ("n", "expected"), [(1, 10), (2, 20), (3, 20), (4, 50), (5, 30), (9, 30), (10, 50), (11, 30), (-3, 40), (-5, 50)]
)
def test_case_values_lists_and_ranges(n: int, expected: int) -> None:
    assert run(CASES, f"n : INT := {n};") == expected


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("FOR i := 1 TO 4 DO F := F * 10 + i; END_FOR", 1234),
        ("FOR i := 6 TO 1 BY -2 DO F := F * 10 + i; END_FOR", 642),
        ("FOR i := 1 TO 9 DO IF i = 3 THEN CONTINUE; END_IF IF i = 5 THEN EXIT; END_IF F := F * 10 + i; END_FOR", 124),
        ("FOR i := 1 TO 3 DO END_FOR F := i;", 4),
        ("FOR i := 5 TO 3 DO END_FOR F := i;", 5),
        ("FOR i := 1 TO 8 BY 3 DO END_FOR F := i;", 10),
        ("FOR i := 1 TO 9 DO IF i = 3 THEN EXIT; END_IF END_FOR F := i;", 3),
        ("n := 4; FOR i := 1 TO n DO n := 2; F := F + 1; END_FOR", 2),
        ("FOR i := 1 TO 9 DO i := i + 1; F := F * 10 + i; CONTINUE; END_FOR", 24690),
        ("FOR i := 1 TO 3 DO FOR n := 1 TO i DO F := F * 10 + n; END_FOR END_FOR", 112123),
        ("WHILE i < 9 DO i := i + 1; IF i MOD 2 = 0 THEN CONTINUE; END_IF F := F * 10 + i; END_WHILE", 13579),
        ("REPEAT i := i + 1; IF i = 2 THEN CONTINUE; END_IF F := F * 10 + i; UNTIL i >= 4 END_REPEAT", 134),
        ("REPEAT i := i + 1; IF i = 3 THEN EXIT; END_IF UNTIL FALSE END_REPEAT F := i;", 3),
        ("F := 1; IF F = 1 THEN RETURN; END_IF F := 2;", 1),
        ("IF i > 0 THEN F := 1; ELSIF i = 0 THEN F := 2; ELSE F := 3; END_IF", 2),
    ],
)
def test_loops_and_jumps(body: str, expected: int) -> None:
    assert run(body, "i : LINT; n : LINT;") == expected


LIBRARY = """
FUNCTION F_Split : BOOL
VAR_INPUT n : UDINT; nBy : UDINT := 10; END_VAR
VAR_OUTPUT nRest : UDINT; nTens : UDINT; END_VAR
nRest := n MOD nBy;
nTens := n / nBy;
F_Split := nTens > 0;
END_FUNCTION

FUNCTION F_Swap : BOOL
VAR_IN_OUT a : DINT; b : DINT; END_VAR
VAR n : DINT; END_VAR
n := a; a := b; b := n;
F_Swap := TRUE;
END_FUNCTION

TYPE ST_Pair : STRUCT
    n : DINT := 7;
    aValues : ARRAY[1..3] OF LREAL := [1.0, 2(2.5)];
END_STRUCT END_TYPE

FUNCTION F_Change : DINT
VAR_INPUT stCopy : ST_Pair; END_VAR
VAR_IN_OUT stSame : ST_Pair; aList : ARRAY[0..2] OF LREAL; END_VAR
stCopy.n := 100;
stCopy.aValues[1] := 100.0;
stSame.n := stSame.n + 1;
aList[2] := stSame.aValues[3];
F_Change := stCopy.n;
END_FUNCTION
"""


def test_outputs_arrive_inside_conditions_too() -> None:
    body = """
    IF F_Split(7, nRest => a) THEN F := 1;
    ELSIF F_Split(n := 42, nTens => b, nRest => a) AND b = 4 THEN F := TO_LINT(a);
    END_IF
    WHILE F_Split(n, nTens => n) DO c := c + 1; END_WHILE
    F := F * 100 + TO_LINT(c);
    """
    assert run(body, "a : UDINT; b : UDINT; c : UDINT; n : UDINT := 12345;", extra={"L.st": LIBRARY}) == 204


def test_the_right_side_of_and_then_runs_only_if_it_is_looked_at() -> None:
    body = "IF n > 5 AND_THEN F_Split(n, nRest => a) THEN F := 1; END_IF F := F * 100 + TO_LINT(a);"
    assert run(body, "a : UDINT := 9; n : UDINT := 4;", extra={"L.st": LIBRARY}) == 9
    assert run(body, "a : UDINT := 9; n : UDINT := 64;", extra={"L.st": LIBRARY}) == 104


def test_in_outs_change_the_caller_and_inputs_do_not() -> None:
    body = """
    F_Swap(x, b := y);
    F := F_Change(stA, stB, aOwn) + x * 1000 + y * 10000;
    IF stA.n <> 7 OR stA.aValues[1] <> 1.0 OR stB.n <> 8 OR aOwn[2] <> 2.5 THEN F := -1; END_IF
    """
    variables = "x : DINT := 1; y : DINT := 2; stA : ST_Pair; stB : ST_Pair; aOwn : ARRAY[0..2] OF LREAL;"
    assert run(body, variables, "DINT", {"L.st": LIBRARY}) == 100 + 2000 + 10000


def test_structs_and_arrays_are_copied_by_assignment() -> None:
    body = """
    stB := stA; stB.n := 1; stB.aValues[2] := 0.0;
    a[1] := stB; a[1].n := 5;
    aTwo := a; aTwo[1].aValues[1] := 9.0;
    m[0, 1] := 3; mTwo := m; mTwo[0, 1] := 4; row := mTwo[0];
    F := stA.n * 1000 + stB.n * 100 + a[1].n * 10 + m[0, 1];
    IF stA.aValues[2] <> 2.5 OR a[1].aValues[1] <> 1.0 OR row[1] <> 4 OR row[2] <> 0 THEN F := -1; END_IF
    """
    variables = """stA : ST_Pair; stB : ST_Pair := (n := 3); a : ARRAY[0..1] OF ST_Pair; aTwo : ARRAY[0..1] OF ST_Pair;
        m : ARRAY[-1..1, 0..2] OF DINT; mTwo : ARRAY[-1..1, 0..2] OF DINT; row : ARRAY[0..2] OF DINT;"""
    assert run(body, variables, "DINT", {"L.st": LIBRARY}) == 7153


MACHINE = {
    "FB_Count.st": """(* counts *)
FUNCTION_BLOCK FB_Count
VAR_INPUT nStep : INT := 1; END_VAR
VAR_OUTPUT nCount : INT; END_VAR
VAR nCalls : UDINT; END_VAR
nCalls := nCalls + 1;
Add(nStep);

METHOD Add : INT // of this instance
VAR_INPUT n : INT; END_VAR
THIS^.nCount := nCount + n;
Add := nCount;
END_METHOD
END_FUNCTION_BLOCK
""",
    "P.st": """PROGRAM P
VAR_INPUT bOn : BOOL; END_VAR
VAR_OUTPUT nSum : INT; END_VAR
VAR
    aCounters : ARRAY[1..3] OF FB_Count := [(nStep := 5)];
    i : INT;
END_VAR
FOR i := 1 TO 3 DO
    aCounters[i].Add(n := i);
    aCOUNTERS[I](nStep := aCounters[i].nStep, ncount => nSum);
END_FOR
nSum := nSum + Glob.nOffset + Glob.LIST[TO_USINT(E_Way.UP)] + Sum();
IF bOn THEN Glob.nOffset := 0; END_IF

METHOD Sum : INT
VAR k : INT; END_VAR
FOR k := 1 TO Glob.COUNT DO Sum := Sum + aCounters[k].nCount; END_FOR
END_METHOD
END_PROGRAM
""",
    "GVLs/Glob.st": """VAR_GLOBAL CONSTANT
    COUNT : INT := 4 - 1;
    LIST : ARRAY[0..COUNT] OF INT := [10, 20, 30, 40];
END_VAR
VAR_GLOBAL nOffset : INT := 1000; END_VAR
""",
    "E_Way.st": "{attribute 'strict'} TYPE E_Way : (DOWN, UP := 2, ASIDE) USINT; END_TYPE",
}


def test_instances_methods_globals_and_spelling() -> None:
    program = load_sources(MACHINE)
    block = program.new("p")
    block.call(bOn=True)
    # counters: 1 + 5, 2 + 1, 3 + 1; nSum of the last is 4
    assert block.nSum == 4 + 1000 + 30 + (6 + 3 + 4)
    assert block.aCounters[0].nCount == 6
    assert program.globals("Glob").nOffset == 0
    block.call()
    assert block.NSUM == 8 + 0 + 30 + (12 + 6 + 8)
    assert program.enum("E_Way") == {"DOWN": 0, "UP": 2, "ASIDE": 3}
    assert program.attributes["E_Way"] == {"strict": ""}
    assert program.new("FB_Count").method("Add", 3) == 3
    assert program.globals("Glob").COUNT == 3


def _export(kind: str, name: str, declaration: str, implementation: str = "", methods: str = "") -> str:
    body = f"<Implementation><ST><![CDATA[{implementation}]]></ST></Implementation>" if kind == "POU" else ""
    return (
        f'<?xml version="1.0" encoding="utf-8"?>\n<TcPlcObject Version="1.1.0.1"><{kind} Name="{name}" Id="{{0}}">'
        f"<Declaration><![CDATA[{declaration}]]></Declaration>{body}{methods}</{kind}></TcPlcObject>"
    )


FB_A = "FUNCTION_BLOCK FB_A\nVAR\n    st : ST_A;\n    nBad : USINT;\nEND_VAR\n"
ST_A = "{attribute 'pack_mode' := '1'}\nTYPE ST_A :\nSTRUCT\n    n : UINT;\nEND_STRUCT\nEND_TYPE\n"
GVL_A = "{attribute 'qualified_only'}\nVAR_GLOBAL CONSTANT\n    N : UINT := 9;\nEND_VAR\n"
FAIL = """<Method Name="Fail" Id="{1}"><Declaration><![CDATA[METHOD PUBLIC Fail : USINT
]]></Declaration><Implementation><ST><![CDATA[(* one *)
Fail := 7 / nBad;
]]></ST></Implementation></Method>"""
EXPORT: dict[str, str | bytes] = {
    "POUs/FB_A.TcPOU": _export("POU", "FB_A", FB_A, "st.n := GVL_A.N;", FAIL).encode("utf-8-sig"),
    "DUTs/ST_A.TcDUT": _export("DUT", "ST_A", ST_A),
    "GVLs/GVL_A.TcGVL": _export("GVL", "GVL_A", GVL_A),
}


def test_twincat_exports_are_read_and_errors_name_method_and_line() -> None:
    program = load_program(EXPORT)
    assert program.attributes["ST_A"] == {"pack_mode": "1"}
    block = program.new("FB_A")
    block.call()
    assert block.st.n == 9
    with pytest.raises(StRuntimeError, match=r"^FB_A\.Fail implementation line 2: division by zero$"):
        block.method("Fail")


@pytest.mark.parametrize(
    ("body", "variables", "message"),
    [
        ("F := 1 / n;", "n : LINT;", "division by zero"),
        ("F := 1 MOD n;", "n : LINT;", "division by zero"),
        ("f1 := 1.0 / f1;", "f1 : LREAL;", "division by zero"),
        ("F := a[n];", "a : ARRAY[0..3] OF LINT; n : UDINT := 4;", "index outside the array"),
        ("F := a[n];", "a : ARRAY[0..3] OF LINT; n : INT := -1;", r"index -1 outside 0\.\.3"),
        ("a[n + 1] := 1;", "a : ARRAY[2..3] OF LINT; n : INT := 3;", r"index 4 outside 2\.\.3"),
        ("F := m[1, n];", "m : ARRAY[0..1, 0..1] OF LINT; n : INT := -1;", r"index -1 outside 0\.\.1"),
        ("F := TO_LINT(f1);", "f1 : LREAL := 1.0E30;", "does not fit"),
        ("F := SHL(n, k);", "n : USINT := 1; k : UINT := 8;", "shift by 8 of 8 bits"),
        ("f1 := SQRT(f1);", "f1 : LREAL := -1.0;", "SQRT of -1.0"),
        ("FOR k := 0 TO n DO F := F + 1; END_FOR", "k : USINT; n : USINT := 255;", "never end"),
        ("IF n - 1 > 5 THEN F := 1; END_IF", "n : UDINT;", "intermediate -1 outside UDINT"),
        ("F := TO_LINT(n + 1);", "n : UINT := 65535;", "intermediate 65536 outside UINT"),
        ("F := p[0];", "p : POINTER TO BYTE;", "null pointer"),
        ("p := ADR(b); F := p[3];", "p : POINTER TO BYTE; b : ARRAY[0..2] OF BYTE;", "index outside the array"),
        ("MEMCPY(ADR(b), ADR(c), 4);", "b : ARRAY[0..2] OF BYTE; c : ARRAY[0..3] OF BYTE;", "4 bytes written"),
        ("MEMCPY(ADR(c), ADR(b), 4);", "b : ARRAY[0..2] OF BYTE; c : ARRAY[0..3] OF BYTE;", "4 bytes read"),
    ],
)
def test_what_could_stop_a_plc_is_an_error_with_its_line(body: str, variables: str, message: str) -> None:
    with pytest.raises(StRuntimeError, match=f"^F line 6: .*{message}"):
        run(f"\n{body}", variables)


def test_both_sides_of_and_are_evaluated() -> None:
    with pytest.raises(StRuntimeError, match="index outside the array"):
        run("IF n < 4 AND a[n] = 0 THEN F := 1; END_IF", "a : ARRAY[0..3] OF LINT; n : UDINT := 4;")
    assert run("IF n < 4 AND_THEN a[n] = 0 THEN F := 1; END_IF", "a : ARRAY[0..3] OF LINT; n : UDINT := 4;") == 0


CRC = """FUNCTION F_Crc : UDINT
VAR_INPUT pData : POINTER TO BYTE; nSize : UDINT; END_VAR
VAR i : UDINT; k : UDINT; n : UDINT; aTable : ARRAY[0..255] OF UDINT; END_VAR
FOR i := 0 TO 255 DO
    n := i;
    FOR k := 1 TO 8 DO
        IF (n AND 1) <> 0 THEN n := SHR(n, 1) XOR 16#EDB8_8320; ELSE n := SHR(n, 1); END_IF
    END_FOR
    aTable[i] := n;
END_FOR
n := 16#FFFF_FFFF;
i := 0;
WHILE i < nSize DO
    n := SHR(n, 8) XOR aTable[(n XOR pData[i]) AND 16#FF];
    i := i + 1;
END_WHILE
F_Crc := NOT n;
END_FUNCTION
"""


def test_a_crc_32_is_that_of_zlib() -> None:
    crc = load_sources({"F_Crc.st": CRC}).function("F_Crc")
    rng = random.Random(3)
    for size in (0, 1, 9, 1300):
        data = rng.randbytes(size)
        assert crc(data, size) == zlib.crc32(data)


def test_real_to_integer_can_be_cut_to_show_that_a_program_does_not_care() -> None:
    text = "FUNCTION F : LINT VAR_INPUT x : LREAL; END_VAR F := TO_LINT(x); END_FUNCTION"
    assert load_program({"F.st": text}).function("F")(2.7) == 3
    assert load_program({"F.st": text}, truncate=True).function("F")(-2.7) == -2


def test_statements_that_did_not_run_are_named() -> None:
    text = "FUNCTION F : INT\nVAR_INPUT b : BOOL; END_VAR\nIF b THEN\n  F := 1;\nELSE\n  F := 2;\nEND_IF\nEND_FUNCTION"
    program = load_program({"F.st": text}, count=True)
    assert program.not_run() == ["F line 3", "F line 4", "F line 6"]
    assert program.function("F")(b=True) == 1
    assert program.not_run() == ["F line 6"]
    assert program.statements() == 3
