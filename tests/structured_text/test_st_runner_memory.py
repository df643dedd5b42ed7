"""The Structured Text runner: unions are memory, pointers look into it, and foreign numbers are looked at first."""

import math
import struct
from typing import Any

import pytest
from st_errors import StRuntimeError, StTypeError
from st_program import Program, load_sources

TYPES = {
    "ST_Knot.st": """TYPE ST_Knot : STRUCT
    t_ns : ULINT;
    q : ARRAY[0..1] OF LREAL;
END_STRUCT END_TYPE""",
    "ST_Msg.st": """{attribute 'pack_mode' := '1'} TYPE ST_Msg : STRUCT
    magic : UDINT;
    mode : UINT;
    kind : USINT;
    on : BOOL;
    aKnots : ARRAY[0..2] OF ST_Knot;
    fOil : REAL;
    nSigned : DINT;
    aTag : ARRAY[0..7] OF BYTE;
END_STRUCT END_TYPE""",
    "U_Msg.st": """TYPE U_Msg : UNION
    m : ST_Msg;
    b : ARRAY[0..95] OF BYTE;
    w : ARRAY[0..11] OF ULINT;
END_UNION END_TYPE""",
}
SIZE = 96
KNOT_1 = 8 + 24


def program(body: str, variables: str = "", method: str = "") -> Program:
    """A function block FB with a union u, some plain variables, and this body."""
    text = f"""FUNCTION_BLOCK FB
VAR_IN_OUT u : U_Msg; END_VAR
VAR_OUTPUT n : ULINT; f : LREAL; END_VAR
VAR {variables} END_VAR
{body}
{method}
END_FUNCTION_BLOCK"""
    return load_sources({**TYPES, "FB.st": text})


def call(body: str, variables: str = "", method: str = "", content: bytes = bytes(SIZE)) -> tuple[Any, Any]:
    """The block after one call, and its union."""
    loaded = program(body, variables, method)
    u = loaded.new_union("U_Msg", content)
    block = loaded.new("FB", u=u)
    block.call()
    return block, u


def test_members_bytes_and_words_are_the_same_memory() -> None:
    _, u = call("""
        u.m.magic := 16#3143_4D48;
        u.m.mode := 16#0201;
        u.b[6] := 9;
        u.m.on := TRUE;
        u.m.aKnots[1].t_ns := 5;
        u.m.aKnots[1].q[1] := -0.5;
        u.w[10] := SHL(ULINT#16#FFFF_FFFE, 32) OR TO_ULINT(u.b[0]);
        u.m.aTag[7] := TO_BYTE(u.w[0] AND 16#FF);
    """)
    expected = bytearray(SIZE)
    struct.pack_into("<IHBB", expected, 0, 0x31434D48, 0x0201, 9, 1)
    struct.pack_into("<Qdd", expected, KNOT_1, 5, 0.0, -0.5)
    struct.pack_into("<fi", expected, 80, struct.unpack("<f", struct.pack("<I", 0x48))[0], -2)
    expected[95] = 0x48
    assert bytes(u.bytes) == bytes(expected)


def test_python_sees_members_too() -> None:
    loaded = program("")
    u = loaded.new_union("U_Msg")
    u.m.magic = 7
    u.m.aKnots[2].q[0] = 1.5
    u.w[1] = 2**64 - 1
    u.b[95] = 3
    assert struct.unpack_from("<I", u.bytes)[0] == 7
    assert struct.unpack_from("<d", u.bytes, 8 + 48 + 8)[0] == 1.5
    assert u.m.aKnots[0].t_ns == 2**64 - 1
    assert u.m.aTag[7] == 3
    u.bytes = bytes(SIZE)
    assert u.m.magic == 0
    with pytest.raises(StRuntimeError, match="has 96 bytes, given 5"):
        u.bytes = bytes(5)


def test_loop_variables_reach_every_element() -> None:
    block, u = call(
        """
        FOR k := 0 TO 2 DO
            FOR j := 0 TO 1 DO
                u.m.aKnots[k].q[j] := TO_LREAL(k * 10 + j);
                n := n + u.w[1 + k * 3 + 1 + j];
            END_FOR
        END_FOR
        f := u.m.aKnots[nAt].q[nAt - 1];
        """,
        "k : UDINT; j : UDINT; nAt : INT := 1;",
    )
    values = [struct.unpack_from("<2d", u.bytes, 8 + 24 * k + 8) for k in range(3)]
    assert values == [(0.0, 1.0), (10.0, 11.0), (20.0, 21.0)]
    assert block.n == sum(struct.unpack("<Q", struct.pack("<d", v))[0] for pair in values for v in pair) % 2**64
    assert block.f == 10.0


@pytest.mark.parametrize("index", ["k", "k + 3", "TO_INT(k) - 2"])
def test_an_index_outside_an_array_in_a_union_is_an_error_though_memory_follows(index: str) -> None:
    loaded = program(f"n := u.m.aKnots[{index}].t_ns;", "k : INT := 3;" if index == "k" else "k : INT := 1;")
    block = loaded.new("FB", u=loaded.new_union("U_Msg"))
    with pytest.raises(StRuntimeError, match=r"^FB line 5: index (3|4|-1) outside 0\.\.2$"):
        block.call()


STRUCTS = """
METHOD Shift : LREAL
VAR_IN_OUT stKnot : ST_Knot; END_VAR
VAR_INPUT stBy : ST_Knot; END_VAR
stKnot.t_ns := stKnot.t_ns + 1;
stKnot.q[0] := stKnot.q[0] + stBy.q[1];
stBy.q[1] := 100.0;
Shift := Sum(stKnot.q);
END_METHOD
METHOD Sum : LREAL
VAR_IN_OUT aQ : ARRAY[0..1] OF LREAL; END_VAR
aQ[1] := aQ[1] + 0.5;
Sum := aQ[0] + aQ[1];
END_METHOD
"""


def test_structs_and_arrays_go_from_a_union_as_in_out_and_by_copy() -> None:
    block, u = call(
        """
        u.m.aKnots[1].q[0] := 2.0;
        u.m.aKnots[2].q[1] := 8.0;
        f := Shift(u.m.aKnots[1], u.m.aKnots[2]);
        stPlain := u.m.aKnots[1];
        f := f + Shift(stPlain, u.m.aKnots[2]);
        stPlain.q[1] := 77.0;
        u.m.aKnots[0] := stPlain;
        u.m.aKnots[2].q := aTwo;
        aTwo := u.m.aKnots[1].q;
        uOther := u;
        uOther.m.aKnots[1].q[0] := 0.0;
        uOther.m.aKnots[2] := u.m.aKnots[1];
        uOther.m.aKnots := u.m.aKnots;
        """,
        "stPlain : ST_Knot; aTwo : ARRAY[0..1] OF LREAL := [3.0, 4.0]; uOther : U_Msg;",
        STRUCTS,
    )
    knots = [struct.unpack_from("<Qdd", u.bytes, 8 + 24 * k) for k in range(3)]
    assert knots == [(2, 18.0, 77.0), (1, 10.0, 0.5), (0, 3.0, 4.0)]
    assert block.f == (10.0 + 0.5) + (18.0 + 1.0)
    assert list(block.aTwo) == [10.0, 0.5]
    assert bytes(block.uOther.bytes) == bytes(u.bytes)


NAN, INFINITY = 0x7FF8 << 48, 0x7FF0 << 48


@pytest.mark.parametrize("bits", [NAN, INFINITY, INFINITY | 1 << 63, NAN | 1])
@pytest.mark.parametrize(
    "use",
    [
        "IF u.m.aKnots[1].q[0] > 1.0 THEN n := 1; END_IF",
        "f := u.m.aKnots[k].q[0];",
        "f := Sum(u.m.aKnots[1].q);",
        "f := Shift(u.m.aKnots[1], st);",
        "st := u.m.aKnots[1];",
    ],
)
def test_a_number_that_is_none_must_not_be_loaded(bits: int, use: str) -> None:
    content = bytearray(SIZE)
    struct.pack_into("<Q", content, KNOT_1 + 8, bits)
    with pytest.raises(StRuntimeError, match=r"^FB(\.\w+)? line \d+: .*(nan|inf).*TwinCAT"):
        call(use, "k : INT := 1; st : ST_Knot;", STRUCTS, bytes(content))


def test_bits_may_be_tested_and_bytes_moved_whatever_they_are() -> None:
    content = bytearray(SIZE)
    struct.pack_into("<Q", content, KNOT_1 + 8, NAN)
    struct.pack_into("<f", content, 80, math.nan)
    block, u = call(
        f"""
        IF (u.w[5] AND {INFINITY}) = {INFINITY} THEN n := 1; END_IF
        uOther := u;
        uOther.m.aKnots[0] := u.m.aKnots[1];
        MEMCPY(destAddr := ADR(uThird), srcAddr := ADR(u), n := SIZEOF(u));
        """,
        "uOther : U_Msg; uThird : U_Msg;",
        content=bytes(content),
    )
    assert block.n == 1
    assert bytes(block.uThird.bytes) == bytes(u.bytes)
    assert bytes(block.uOther.bytes)[8:32] == bytes(content)[KNOT_1 : KNOT_1 + 24]


def test_great_finite_numbers_pass_the_guard() -> None:
    content = bytearray(SIZE)
    struct.pack_into("<2d", content, KNOT_1 + 8, 1.7e308, 1.7e308)
    block, _ = call("aQ := u.m.aKnots[1].q; f := aQ[1];", "aQ : ARRAY[0..1] OF LREAL;", content=bytes(content))
    assert block.f == 1.7e308


def test_pointers_read_and_write_what_they_point_at() -> None:
    block, u = call(
        """
        p := ADR(u);
        p[3] := 16#31;
        p^ := 16#48;
        n := TO_ULINT(p[0]) + TO_ULINT(At(ADR(u.m.aTag[2]), 1));
        p := ADR(aOwn[2]);
        p[1] := 5;
        Put(p, 0, 6);
        MEMSET(destAddr := ADR(u.m.aTag[4]), fillByte := 16#AB, n := 3);
        MEMCPY(ADR(aOwn), ADR(u.m.magic), 2);
        MEMCPY(destAddr := ADR(fBits), srcAddr := ADR(nBits), n := 8);
        MEMSET(ADR(stZero), 0, SIZEOF(stZero));
        f := fBits;
        """,
        """p : POINTER TO BYTE; aOwn : ARRAY[0..3] OF BYTE; nBits : ULINT := 16#3FF8_0000_0000_0000; fBits : LREAL;
        stZero : ST_Knot := (t_ns := 4, q := [1.0, 2.0]);""",
        """
METHOD At : BYTE
VAR_INPUT pData : POINTER TO BYTE; i : UDINT; END_VAR
At := pData[i];
END_METHOD
METHOD Put
VAR_INPUT pData : POINTER TO BYTE; i : INT; nValue : BYTE; END_VAR
pData[i] := nValue;
END_METHOD""",
        content=bytes(range(SIZE)),
    )
    assert (u.bytes[0], u.bytes[3]) == (0x48, 0x31)
    assert block.n == 0x48 + 91
    assert block.aOwn == [0x48, 1, 6, 5]
    assert bytes(u.m.aTag) == bytes([88, 89, 90, 91, 0xAB, 0xAB, 0xAB, 95])
    assert block.f == 1.5
    assert (block.stZero.t_ns, block.stZero.q) == (0, [0.0, 0.0])


def test_sizes_are_those_of_the_layout() -> None:
    block, _ = call("n := SIZEOF(ST_Msg) * 1_000_000 + SIZEOF(u.m.aKnots) * 1000 + SIZEOF(U_Msg);")
    assert block.n == 96_072_096


def test_a_struct_with_a_gap_is_refused() -> None:
    types = {
        "ST_Gap.st": "TYPE ST_Gap : STRUCT n : USINT; f : LREAL; END_STRUCT END_TYPE",
        "U_Gap.st": "TYPE U_Gap : UNION m : ST_Gap; b : ARRAY[0..8] OF BYTE; END_UNION END_TYPE",
    }
    with pytest.raises(StTypeError, match=r"ST_Gap\.f at byte 1 is not aligned"):
        load_sources(types)


def test_what_python_hands_in_is_checked() -> None:
    loaded = program("", method="METHOD Take\nVAR_INPUT k : USINT; END_VAR\nVAR_IN_OUT v : U_Msg; END_VAR\nEND_METHOD")
    block = loaded.new("FB", u=loaded.new_union("U_Msg"))
    with pytest.raises(StTypeError, match="256 is no USINT"):
        block.method("Take", k=256, v=block.u)
    with pytest.raises(StTypeError, match="U_Msg given bytes"):
        block.method("Take", k=1, v=b"")
    with pytest.raises(StTypeError, match="takes"):
        block.method("Take", k=1)
    with pytest.raises(StTypeError, match="no method"):
        block.method("Give")
    with pytest.raises(StTypeError, match="no input n"):
        loaded.new("FB", n=1)
    with pytest.raises(AttributeError, match="no variable nothing"):
        assert block.nothing
