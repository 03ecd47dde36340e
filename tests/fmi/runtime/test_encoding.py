"""XML is decoded as it declares; document types and entities are refused in every encoding."""

from __future__ import annotations

from pathlib import Path

import pytest

from rotorsim.errors import RotorsimError
from rotorsim.fmi.description.reader import read_description
from rotorsim.fmi.description.xml_reader import read_xml
from rotorsim.fmi.runtime.slave import describe_fmu
from tests.fmi.gauge import description, gauge_fmu

ENCODINGS = [
    ("ISO-8859-1", "latin-1", "Läufer µ"),
    ("iso-8859-15", "iso8859-15", "Preis: 1 €"),
    ("windows-1252", "cp1252", "Läufer – 1 €"),
    ("Windows-1251", "cp1251", "ротор"),
    ("UTF-16", "utf-16", "Läufer ротор 転子"),
    ("UTF-16", "utf-16-le", "Läufer ротор 転子"),
    ("utf-16", "utf-16-be", "Läufer ротор 転子"),
    ("UTF-8", "utf-8", "転子"),
    ("UTF-8", "utf-8-sig", "転子"),
]


def written(encoding: str, text: str) -> str:
    body = description().replace('modelName="gauge"', f'modelName="gauge" description="{text}"')
    return f'<?xml version="1.0" encoding="{encoding}" standalone="no"?>\n{body}'


@pytest.mark.parametrize(("encoding", "codec", "text"), ENCODINGS)
def test_the_declaration_decides(tmp_path: Path, encoding: str, codec: str, text: str) -> None:
    data = written(encoding, text).encode(codec)
    assert read_description(data, "x").description == text
    assert describe_fmu(gauge_fmu(tmp_path, data)).description == text


@pytest.mark.parametrize(("encoding", "codec", "text"), ENCODINGS)
def test_entities_and_document_types_are_refused(encoding: str, codec: str, text: str) -> None:
    for inside in ('<!DOCTYPE a [<!ENTITY b "c">]>', '<!DOCTYPE a SYSTEM "file:///etc/passwd">'):
        data = f'<?xml version="1.0" encoding="{encoding}"?>{inside}<a>{text}&b;</a>'.encode(codec)
        with pytest.raises(RotorsimError, match="a document type"):
            read_xml(data, "x")
    data = f'<?xml version="1.0" encoding="{encoding}"?><a>{text}&b;</a>'.encode(codec)
    with pytest.raises(RotorsimError, match="undefined entity"):
        read_xml(data, "x")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (
            b'<?xml version="1.0" encoding="windows-1252"?>\n<a b="\x81"/>',
            "x:2:7: error: not windows-1252: it does not know this character",
        ),
        (
            b'<?xml version="1.0" encoding="UTF-7"?><a/>',
            "x:1:1: error: the encoding is UTF-7; read are UTF-8, UTF-16, ISO-8859-1 to 16 and windows-1250 to 1258",
        ),
        (
            b'<?xml version="1.0" encoding="rot13"?><a/>',
            "x:1:1: error: the encoding is rot13; read are UTF-8, UTF-16, ISO-8859-1 to 16 and windows-1250 to 1258",
        ),
        (
            b'<?xml version="1.0" encoding="UTF-16"?><a/>',
            "x:1:1: error: the encoding is said to be UTF-16, but its first bytes are not",
        ),
        (
            '<?xml version="1.0" encoding="UTF-8"?><a/>'.encode("utf-16-le"),
            "x:1:1: error: the encoding is said to be UTF-8, but its first bytes are utf-16-le",
        ),
        (
            '<?xml version="1.0" encoding="UTF-16"?><a/>'.encode("utf-16-le")[:-1],
            "x:1:43: error: not UTF-16: it does not know this character",
        ),
        (
            b'<?xml version="1.0" encoding="UTF-8"?><a b="\xff"/>',
            "x:1:45: error: not XML: not well-formed (invalid token)",
        ),
    ],
)
def test_what_cannot_be_decoded(data: bytes, message: str) -> None:
    with pytest.raises(RotorsimError) as caught:
        read_xml(data, "x")
    assert str(caught.value).splitlines()[0] == message
