"""What a person meets at a terminal or a pipe: whole lines, and an answer to Ctrl-C at any moment."""

from __future__ import annotations

from pathlib import Path

import pytest

from needle_rig.cli import _output
from needle_rig.errors import BadInput
from needle_rig.service.api.orders import read_order

ROOT = Path(__file__).parents[3]
INTERRUPTED = """
import runpy
import sys


class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            raise KeyboardInterrupt
        return None


sys.meta_path.insert(0, Finder())
sys.argv = ["needle-rig", "parameters", "--json"]
runpy.run_module("needle_rig", run_name="__main__")
"""
LONG = "a note of many words that goes on " * 10


def test_a_pipe_gets_whole_lines(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    _output.console().print(LONG)
    assert capsys.readouterr().out == f"{LONG}\n"


def test_who_asks_for_a_width_gets_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    _output.console().print(LONG)
    assert max(map(len, capsys.readouterr().out.splitlines())) <= 60


def test_a_refused_order_sends_no_person_to_an_api() -> None:
    with pytest.raises(BadInput) as refused:
        read_order("jog", b'{"to_deg": "far"}')
    assert "openapi" not in str(refused.value)
