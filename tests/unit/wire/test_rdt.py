"""RDT of ATI's sensors, byte by byte as the manual has it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from needle_rig.errors import BadInput
from needle_rig.wire.rdt import START, STOP, decode_page, decode_record, encode_request

PAGE = """<?xml version="1.0" encoding="ISO-8859-1"?>
<netft><cfgcpf>1000000</cfgcpf><cfgcpt>{cpt}</cfgcpt><scfgfu>N</scfgfu><scfgtu>{unit}</scfgtu>
<comrdte>{rdt}</comrdte><comrdtrate>1000</comrdtrate>{more}</netft>"""


def page(cpt: str = "64000000", unit: str = "N-m", rdt: str = "Enabled", more: str = "") -> bytes:
    return PAGE.format(cpt=cpt, unit=unit, rdt=rdt, more=more).encode()


def test_requests_are_the_manuals_bytes() -> None:
    assert encode_request(START) == bytes.fromhex("1234 0002 00000000")
    assert encode_request(STOP) == bytes.fromhex("1234 0000 00000000")


def test_a_record_is_read_high_byte_first() -> None:
    record = decode_record(
        bytes.fromhex("00000002 00010203 80020000 00000001 00000002 00000003 fffffffe ffffff00 00000100")
    )
    assert record is not None
    assert (record.rdt_sequence, record.ft_sequence, record.status) == (2, 0x10203, 0x80020000)
    assert record.force == (1, 2, 3)
    assert record.torque == (-2, -256, 256)


@given(st.binary(max_size=80).filter(lambda data: len(data) != 36))
def test_a_datagram_of_another_length_is_no_record(data: bytes) -> None:
    assert decode_record(data) is None


@pytest.mark.parametrize(
    ("unit", "counts_per_nm"),
    [
        ("N-m", 1000.0),
        ("Nm", 1000.0),
        ("N-mm", 1e6),
        ("Nmm", 1e6),
        ("kN-m", 1.0),
        ("lbf-in", 1000.0 / 0.1129848290276167),
        ("lbf-ft", 1000.0 / 1.3558179483314004),
        ("kgf-cm", 1000.0 / 0.0980665),
    ],
)
def test_counts_per_torque_are_told_in_every_unit_of_the_sensor(unit: str, counts_per_nm: float) -> None:
    assert decode_page(page("1000", unit)).counts_per_nm == pytest.approx(counts_per_nm, rel=1e-12)


def test_the_internal_rate_is_the_pages_or_the_manuals() -> None:
    assert decode_page(page(more="<runrate>7812</runrate>")).internal_rate_hz == 7812.0
    assert decode_page(page()).internal_rate_hz == 7000.0


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (page(unit="furlong"), "the unit of torque, scfgtu, is 'furlong'"),
        (page(cpt="0"), "cfgcpt, is '0', no positive number"),
        (page(cpt="nan"), "cfgcpt, is 'nan', no positive number"),
        (page(rdt="Disabled"), "does not send by RDT"),
        (b"<html><body>404", "is no XML"),
        (b"", "is no XML"),
        (b'<!DOCTYPE x [<!ENTITY a "b">]><netft/>', "has more in it than values"),
        (b"\xff\xfe\x00", "is no XML"),
    ],
)
def test_a_page_that_cannot_be_used_is_one_sentence(content: bytes, told: str) -> None:
    with pytest.raises(BadInput) as refused:
        decode_page(content)
    assert told in str(refused.value)
    assert "\n" not in str(refused.value)


@given(st.binary(max_size=300))
def test_any_page_is_read_or_refused(content: bytes) -> None:
    told = ""
    try:
        assert decode_page(content).counts_per_nm > 0.0
    except BadInput as refused:
        told = str(refused)
    assert "\n" not in told
