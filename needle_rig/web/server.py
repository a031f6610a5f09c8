"""The page's server: static modules, the rig's stream and orders, and the workbench's jobs."""

from __future__ import annotations

import asyncio
import contextlib
import json
import secrets
import socket as sockets
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, HTMLResponse, JSONResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket

from needle_rig.control.strategy import find_strategies
from needle_rig.errors import Aborted, BadInput, NeedleRigError, RigFault
from needle_rig.model import parameter_sets
from needle_rig.recording.watch_summary import read_contradiction
from needle_rig.service.connections import Connections
from needle_rig.service.endpoint import QUEUE
from needle_rig.service.orders import read_order
from needle_rig.service.serving import connection_limit, server
from needle_rig.web.estimate import shaft_estimate
from needle_rig.web.glossary import glossary_html
from needle_rig.web.guard import LOOPBACK, Guard
from needle_rig.web.jobs import Jobs
from needle_rig.web.lessons_process import Lessons
from needle_rig.web.live import STOP_BYTES, live
from needle_rig.web.places import COMPARISON, DATASET, DIAGNOSIS, MODEL
from needle_rig.web.rig_link import ORDERS, RigLink
from needle_rig.web.sources import NOTES_BYTES, Sources
from needle_rig.web.uploads import TooMuch, Uploads, data_in, model_in
from needle_rig.workbench.contest.strategies_table import NEEDS_OTHERS

STATIC = Path(__file__).parent / "static"
BODY_BYTES = 64 << 10
JOB_BYTES = 512 << 10
"""A mapping of some hundred channels, each with its reason."""
BODY_S = 10.0
CONNECTIONS = 256
"""Of strangers, and of those with the token: far more than pages of one person."""
TARGETS = 8
SEEDS = 10
OWN_DESCRIPTORS = 256
"""Files of jobs and uploads, and connections to the daemon."""

OF_A_MODEL = ("compare", "diagnose", "take_values", "undo", "strategies", "learn", "adopt_law")
OF_DATA = ("compare", "diagnose", "take_values", "adopt", "show", "export", "learn", "adopt_law")
"""Kinds of work that are given a model or none, and that are given data."""
OF_VALUES = ("refit", "fixed", "free")
"""Fields of a comparison, which its record checks."""

Document = dict[str, Any]


@dataclass(frozen=True)
class Settings:
    """What the command line chose."""

    socket: Path | None
    data: tuple[Path, ...]
    runs: Path
    effects: tuple[str, ...]
    """Folders with effects of one's own: Python that runs, which no upload can add to."""
    jobs: int
    """Processes of a diagnosis."""


class Page:
    """Everything behind the page, below one temporary `folder`."""

    def __init__(self, settings: Settings, folder: Path) -> None:
        self._settings, self._folder = settings, folder
        self.rig = RigLink(settings.socket)
        self.jobs = Jobs()
        self.lessons = Lessons(settings.effects)
        self.uploads = Uploads(folder / "uploads")
        self.sources = Sources(settings.data, settings.runs, self.uploads)
        self._made: dict[str, Path] = {}
        self._drafts: dict[str, list[str]] = {}
        self._laws = 0

    # the rig

    async def live(self, socket: WebSocket) -> None:
        """What the daemon tells, and stops to it."""
        await live(self.rig, socket)

    async def order(self, request: Request) -> Response:
        """One of the daemon's orders."""
        name = request.path_params["order"]
        if name not in ORDERS:
            raise HTTPException(404)
        content = read_order(name, await body(request)).model_dump(exclude_none=True)
        return JSONResponse(await self.rig.order(name, content), 202)

    async def estimate(self, request: Request) -> Response:
        """The matrix that gives the shaft's angle between its sensors."""
        rig = json.loads(await body(request))
        try:
            return JSONResponse(shaft_estimate(rig).as_json())
        except (KeyError, TypeError, ValueError, ArithmeticError):
            raise BadInput("this is no rig as the daemon tells it") from None

    # the workbench

    async def about(self, _: Request) -> Response:
        """What can be chosen: data, strategies, parameter sets."""
        sources = await asyncio.to_thread(self.sources.datasets)
        return JSONResponse(
            {
                "data": [{"key": s.key, "name": s.name, "kind": s.kind} for s in sources],
                "strategies": [
                    {"name": name, "text": (kind.__doc__ or name).strip().splitlines()[0]}
                    for name, kind in find_strategies().items()
                    if name not in NEEDS_OTHERS
                ],
                "parameters": sorted(parameter_sets()),
                "runs": str(self._settings.runs),
            }
        )

    async def begin_job(self, request: Request) -> Response:
        """Start a computation: its key."""
        asked = as_mapping(await body(request, JOB_BYTES))
        kind, out = asked.get("kind"), self._folder / "jobs" / secrets.token_hex(8)
        given: Document = {}
        if kind in OF_DATA:
            given["data"] = await asyncio.to_thread(self.sources.paths, texts(asked.get("data")))
        if kind in OF_A_MODEL:
            given["model"] = self._model(asked.get("model"))
        drafts = self._drafts_of(asked.get("model"), asked.get("diagnosis"))
        if kind == "compare":
            given |= {field: asked[field] for field in OF_VALUES if field in asked}
        elif kind == "figure":
            given["comparison"] = self._file(str(asked.get("compared")), COMPARISON)
            given["what"] = str(asked.get("what"))
        elif kind == "open":
            upload = self.uploads.get(str(asked.get("upload")))
            if (dropped := model_in(upload.folder)) is None:
                raise BadInput(f"{upload.name}: holds no model file")
            given["model"] = str(dropped)
        elif kind == "diagnose":
            given["quick"] = asked.get("quick") is True
        elif kind == "adopt":
            given["diagnosis"] = self._file(asked.get("diagnosis"), DIAGNOSIS)
            given["chosen"] = texts(asked.get("chosen", []))
        elif kind == "learn":
            self._laws += 1
            given["draft"] = str(out / f"learnt_law_{self._laws}.py")
        elif kind == "adopt_law":
            folder = self._made.get(str(asked.get("learnt")))
            if folder is None:
                raise BadInput("what was learnt is not there any more; learn it again")
            given["effect"] = str(asked.get("law"))
            drafts = [*drafts, str(folder)]
        elif kind == "undo" and given["model"] is None:
            raise BadInput("there is no step to take back")
        elif kind == "export":
            given["form"] = str(asked.get("form"))
        elif kind == "strategies":
            given |= self._contest(asked, given["model"])
        elif kind in ("guess", "import"):
            given |= await self._recordings(str(kind), asked, out)
        elif "data" not in given and kind != "undo":
            raise BadInput("this is no computation that the page knows")
        if kind in (*OF_A_MODEL, "adopt", "open"):
            given["effects"] = [*self._settings.effects, *drafts]
        out.mkdir(parents=True, exist_ok=True)
        key = self.jobs.start(str(kind), {**given, "out": str(out), "jobs": self._settings.jobs})
        self._made[key] = out
        self._drafts[key] = drafts
        if kind == "import":
            self.sources.imported[f"imported:{key}"] = out / DATASET
        return JSONResponse({"job": key}, 202)

    def _drafts_of(self, *keys: object) -> list[str]:
        """Folders of the learnt laws in what these jobs made."""
        return list(dict.fromkeys(folder for key in keys for folder in self._drafts.get(str(key), [])))

    async def _recordings(self, kind: str, asked: Document, out: Path) -> Document:
        """An upload of recordings, with its mapping or with the shaft of its guess."""
        upload = self.uploads.get(str(asked.get("upload")))
        given: Document = {"folder": str(upload.folder), "files": sorted(upload.files)}
        given["files"] = [file for file in given["files"] if (upload.folder / file).is_file()]
        if kind == "import":
            return given | {"mapping": asked.get("mapping")}
        layout, source = asked.get("layout"), asked.get("layout_of")
        place: str | None = None
        if isinstance(layout, str) and layout.strip():
            out.mkdir(parents=True)
            (out / "layout.yaml").write_text(layout, encoding="utf-8")
            place = str(out / "layout.yaml")
        elif source is not None:
            place = (await asyncio.to_thread(self.sources.paths, texts([source])))[0]
        return given | {"layout": place, "name": upload.name}

    def _contest(self, asked: Document, model: str | None) -> Document:
        """Targets, runs, and the rig that planned knows: what was learnt, or else a parameter set."""
        targets, seeds, parameters = asked.get("targets_deg"), asked.get("seeds"), asked.get("parameters")
        if not isinstance(targets, list) or not isinstance(seeds, int) or parameters not in parameter_sets():
            raise BadInput("give targets in degrees, a number of runs, and a parameter set of the list")
        if not 1 <= len(targets) <= TARGETS or not 1 <= seeds <= SEEDS:
            raise BadInput(f"give 1 to {TARGETS} targets and 1 to {SEEDS} runs of each kind")
        rig = model or parameters
        return {"targets_deg": targets, "seeds": seeds, "parameters": rig, "model": rig}

    def _model(self, key: object) -> str | None:
        """The model that a job made, or the name of a parameter set; None for the null model."""
        if isinstance(key, str) and key in parameter_sets():
            return key
        return self._file(key, MODEL)

    def _file(self, key: object, name: str) -> str | None:
        """The file of this name that a job made; None for no key."""
        if key is None:
            return None
        path = self._made.get(str(key), self._folder) / name
        if not path.is_file():
            raise BadInput("what this builds on is not there any more; compute it again")
        return str(path)

    async def job(self, request: Request) -> Response:
        """How far a computation is, or end it."""
        key = request.path_params["key"]
        job = self.jobs.cancel(key) if request.method == "DELETE" else self.jobs.get(key)
        return JSONResponse(job.as_json())

    async def file(self, request: Request) -> Response:
        """A file that a job wrote, by its bare name."""
        key, name = request.path_params["key"], request.path_params["name"]
        folder = self._made.get(key)
        listed = [] if folder is None else [path.name for path in folder.iterdir() if path.is_file()]
        if folder is None or name not in listed:
            raise BadInput(f"{name[:80]}: no such file; compute it again")
        return FileResponse(folder / name, filename=name, content_disposition_type="attachment")

    async def begin_upload(self, request: Request) -> Response:
        """A place for files that a person drops."""
        asked = as_mapping(await body(request))
        return JSONResponse({"upload": self.uploads.begin(str(asked.get("name", "")))}, 201)

    async def upload(self, request: Request) -> Response:
        """One file of an upload."""
        key, path = request.path_params["key"], request.path_params["path"]
        try:
            await self.uploads.take(key, path, request.stream())
        except ClientDisconnect:
            raise BadInput(f"{path[:80]}: the upload broke off; drop it again") from None
        found = self.uploads.get(key)
        data = await asyncio.to_thread(data_in, found.folder)
        model = await asyncio.to_thread(model_in, found.folder)
        return JSONResponse({"files": len(found.files), "data": len(data), "model": model is not None}, 201)

    # runs

    async def runs(self, _: Request) -> Response:
        """The recorded runs with tags and notes, newest first."""

        def listed() -> list[Document]:
            return [self.sources.run_document(run) for run in self.sources.runs()]

        return JSONResponse({"runs": await asyncio.to_thread(listed)})

    async def watch(self, _: Request) -> Response:
        """What a person should know besides the state; empty where there is nothing.

        `contradiction` is what the newest run says against the model of the rig file, `version` that the
        daemon is of another version than the page.
        """
        said = await asyncio.to_thread(read_contradiction, self._settings.runs)
        return JSONResponse({"contradiction": said, "version": self.rig.other_version or ""})

    async def notes(self, request: Request) -> Response:
        """Keep tags and a note beside a run."""
        content = await body(request, NOTES_BYTES)
        notes = await asyncio.to_thread(self.sources.keep_notes, request.path_params["name"], content)
        return JSONResponse(notes.model_dump())

    # effects

    async def effects(self, _: Request) -> Response:
        """The library, and the sentence of each own effect that cannot be used."""
        return JSONResponse(await self.lessons.ask(None, {}))

    async def lesson(self, request: Request) -> Response:
        """One effect in the standard trial."""
        asked = as_mapping(await body(request))
        values = asked.get("values")
        if not isinstance(values, dict) or not all(isinstance(v, int | float) for v in values.values()):
            raise BadInput("values: give a number for each parameter")
        data = asked.get("data")
        path = None if data is None else (await asyncio.to_thread(self.sources.paths, texts([data])))[0]
        return JSONResponse(await self.lessons.ask(str(asked.get("effect")), values, path))

    @contextlib.asynccontextmanager
    async def lifespan(self, _: Starlette) -> AsyncIterator[None]:
        """Listens to the daemon while the server runs."""
        self.rig.open()
        try:
            yield
        finally:
            await self.jobs.close()
            self.lessons.close()
            await self.rig.close()


def application(page: Page, port: int, token: str) -> Guard:
    """The whole server at `port`, guarded."""

    def put(path: str, answer: Callable[[Request], Awaitable[Response]], *methods: str) -> Route:
        return Route(path, answer, methods=list(methods))

    app = Starlette(
        routes=[
            WebSocketRoute("/api/live", page.live),
            put("/api/rig/{order}", page.order, "POST"),
            put("/api/estimate", page.estimate, "POST"),
            put("/api/about", page.about, "GET"),
            put("/api/jobs", page.begin_job, "POST"),
            put("/api/jobs/{key}", page.job, "GET", "DELETE"),
            put("/api/jobs/{key}/{name}", page.file, "GET"),
            put("/api/uploads", page.begin_upload, "POST"),
            put("/api/uploads/{key}/{path:path}", page.upload, "PUT"),
            put("/api/runs", page.runs, "GET"),
            put("/api/watch", page.watch, "GET"),
            put("/api/runs/{name}/notes", page.notes, "PUT"),
            put("/api/effects", page.effects, "GET"),
            put("/api/lesson", page.lesson, "POST"),
            put("/glossary.html", glossary, "GET"),
            Mount("/", StaticFiles(directory=STATIC, html=True)),
        ],
        exception_handlers={NeedleRigError: refuse, HTTPException: refuse_path},
        lifespan=page.lifespan,
    )
    return Guard(app, port, token)


async def glossary(_: Request) -> Response:
    """The words of the documentation."""
    return HTMLResponse(await asyncio.to_thread(glossary_html))


async def body(request: Request, limit_bytes: int = BODY_BYTES) -> bytes:
    """A short body, within its time."""
    content = bytearray()
    try:
        async with asyncio.timeout(BODY_S):
            async for chunk in request.stream():
                content += chunk
                if len(content) > limit_bytes:
                    raise TooMuch(f"the request is longer than {limit_bytes} bytes; send less")
    except (ClientDisconnect, TimeoutError):
        raise BadInput("the request broke off; send it again") from None
    return bytes(content)


def as_mapping(content: bytes) -> Document:
    """A JSON object; raises BadInput."""
    try:
        asked = json.loads(content or b"{}")
    except (ValueError, RecursionError):
        asked = None
    if not isinstance(asked, dict):
        raise BadInput("the request is no JSON object")
    return asked


def texts(given: object) -> list[str]:
    """A list of texts; raises BadInput."""
    if not isinstance(given, list) or not all(isinstance(each, str) for each in given):
        raise BadInput("no data was chosen; choose a dataset, or runs")
    return given


async def refuse(_: Request, error: Exception) -> Response:
    """A sentence for the page."""
    assert isinstance(error, NeedleRigError)
    kinds = ((TooMuch, 413), (Aborted, 409), (RigFault, 503))
    status = next((code for kind, code in kinds if isinstance(error, kind)), 422)
    return JSONResponse({"error": str(error), "exit_code": error.exit_code}, status)


async def refuse_path(request: Request, error: Exception) -> Response:
    """A path or a method that is not there."""
    assert isinstance(error, HTTPException)
    text = f"{request.method} {request.url.path[:80]}: {error.detail.lower()}"
    return JSONResponse({"error": text, "exit_code": BadInput.exit_code}, error.status_code)


def listening(port: int) -> sockets.socket:
    """A socket at the loopback address; raises BadInput when the port is taken."""
    listener = sockets.socket(sockets.AF_INET, sockets.SOCK_STREAM)
    listener.setsockopt(sockets.SOL_SOCKET, sockets.SO_REUSEADDR, 1)
    listener.setblocking(False)
    try:
        listener.bind((LOOPBACK, port))
        listener.listen(QUEUE)
    except OSError as error:
        listener.close()
        raise BadInput(
            f"--port {port}: cannot listen there ({error.strerror}); choose another, or 0"
        ) from None
    return listener


async def serve(page: Page, listener: sockets.socket, token: str, ready: Callable[[], None]) -> None:
    """Serve until SIGINT or SIGTERM."""
    connections = Connections(
        listener, connection_limit(CONNECTIONS, OWN_DESCRIPTORS), timed_by_application=True
    )
    served = server(
        application(page, listener.getsockname()[1], token),
        connections,
        server_header=False,
        ws_max_size=STOP_BYTES,
        ws_per_message_deflate=False,
    )
    sweeping = asyncio.create_task(connections.sweep())
    running = asyncio.create_task(served.serve())
    while not served.started and not running.done():
        await asyncio.sleep(0.01)
    ready()
    try:
        await running
    finally:
        sweeping.cancel()
