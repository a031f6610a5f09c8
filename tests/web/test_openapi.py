"""The server's OpenAPI document is of its routes and answers; the browser's types are made from it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from starlette.routing import Route

from needle_rig.web.guard import Keys
from needle_rig.web.openapi import ROUTES, openapi_document, schema
from needle_rig.web.server import Page, Settings, application
from needle_rig.web.static_files import STATIC
from needle_rig.web.store import opened
from scripts.web_types import types
from tests.web.fitting import fits
from tests.web.served import Served


def test_every_route_is_in_the_document_and_none_besides(tmp_path: Path) -> None:
    with opened(tmp_path / "runs", tmp_path / "otherwise") as (store, _):
        page = Page(Settings(None, (), tmp_path / "runs", (), 1), tmp_path, store)
        app: Any = application(page, 80, Keys("all"))._app
        found = [r for r in app.routes if isinstance(r, Route) and r.path.startswith("/api/")]
        served = {(m, r.path.replace(":path", "")) for r in found for m in r.methods or ()}
    assert {(method, path) for method, path in served if method != "HEAD"} == {
        (r.method, r.path) for r in ROUTES
    }


def test_the_browsers_types_are_those_of_the_document() -> None:
    assert (STATIC / "types.d.ts").read_text(encoding="utf-8") == types(), "run scripts/web_types.py"


def test_no_module_of_the_page_has_an_unchecked_type() -> None:
    for path in sorted(STATIC.glob("*.js")):
        types = re.findall(r"@(?:type|param|returns|typedef|template) \{.*", path.read_text(encoding="utf-8"))
        # an answer has its type where it is kept
        told = [one.replace("Promise<any>", "") for one in types]
        assert not [one for one in told if re.search(r"[:{<(|] *any *[\[\]}|,>);]", one)], path.name


ASKED = ("about", "jobs", "session", "runs", "watch", "trends")


@pytest.mark.whole
@pytest.mark.parametrize("path", ASKED)
def test_an_answer_is_as_the_document_says(served: Served, path: str) -> None:
    operation = openapi_document()["paths"][f"/api/{path}"]["get"]
    told = operation["responses"]["200"]["content"]["application/json"]["schema"]
    fits(served.ask("GET", f"/api/{path}").json(), told, path)
    assert served.ask("GET", "/api/openapi").json()["openapi"] == "3.1.0"


@pytest.mark.parametrize(("kind", "value"), [(list[int], ["x"]), (dict[str, int], 3), (int | None, "x")])
def test_what_does_not_fit_is_noticed(kind: Any, value: Any) -> None:
    with pytest.raises((AssertionError, AttributeError)):
        fits(value, {"properties": {"a": schema(kind, {})}, "required": ["a"]}, "it")
    with pytest.raises((AssertionError, AttributeError)):
        fits({"a": value}, {"properties": {"b": schema(kind, {})}, "required": ["b"]}, "it")


def test_a_kind_without_a_schema_is_an_error() -> None:
    with pytest.raises(TypeError, match="no schema"):
        schema(set[int], {})
