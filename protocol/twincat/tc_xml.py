"""TwinCAT's file form: TcPlcObject XML around ST text, with ids that are the same in every export."""

import uuid
from xml.sax.saxutils import quoteattr

from protocol.errors import LocalProtocolError
from protocol.twincat.pou import Pou

_NAMESPACE = uuid.uuid5(uuid.NAMESPACE_DNS, "hmlink.longreach")
_HEAD = '<?xml version="1.0" encoding="utf-8"?>\n<TcPlcObject Version="1.1.0.1" ProductVersion="3.1.4024.0">\n'


def dut_xml(name: str, text: str) -> str:
    """A .TcDUT file."""
    return (
        f"{_HEAD}  <DUT Name={quoteattr(name)} Id={_id('DUT', name)}>\n{_declaration(text)}  </DUT>\n</TcPlcObject>\n"
    )


def gvl_xml(name: str, text: str) -> str:
    """A .TcGVL file."""
    return (
        f"{_HEAD}  <GVL Name={quoteattr(name)} Id={_id('GVL', name)}>\n{_declaration(text)}  </GVL>\n</TcPlcObject>\n"
    )


def pou_xml(pou: Pou) -> str:
    """A .TcPOU file with its methods."""
    parts = [_declaration(pou.declaration), _body(pou.body)]
    for method in pou.methods:
        identity = _id("METHOD", f"{pou.name}.{method.name}")
        parts.append(f"    <Method Name={quoteattr(method.name)} Id={identity}>\n")
        parts.append(_declaration(method.declaration) + _body(method.body) + "    </Method>\n")
    special = ' SpecialFunc="None"'
    head = f"  <POU Name={quoteattr(pou.name)} Id={_id('POU', pou.name)}{special}>\n"
    return f"{_HEAD}{head}{''.join(parts)}  </POU>\n</TcPlcObject>\n"


def _id(kind: str, name: str) -> str:
    return quoteattr("{" + str(uuid.uuid5(_NAMESPACE, f"{kind} {name}")) + "}")


def _cdata(text: str) -> str:
    if "]]>" in text:
        raise LocalProtocolError("ST source: ']]>' cannot stand in a TwinCAT file; write '] ]>'")
    return f"<![CDATA[{text}]]>"


def _declaration(text: str) -> str:
    return f"    <Declaration>{_cdata(text)}</Declaration>\n"


def _body(text: str) -> str:
    return f"    <Implementation>\n      <ST>{_cdata(text)}</ST>\n    </Implementation>\n"
