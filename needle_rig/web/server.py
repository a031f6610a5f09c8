"""The page's server: static modules, the rig's stream and orders, and the workbench's jobs."""

from __future__ import annotations

import asyncio
import contextlib
import json
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
from starlette.websockets import WebSocket

from needle_rig.control.strategy import find_strategies, sentence
from needle_rig.errors import Aborted, BadInput, NeedleRigError, RigFault
from needle_rig.model import parameter_sets
from needle_rig.physics.machine import MACHINES, NEEDLE
from needle_rig.recording.watch_summary import read_contradiction
from needle_rig.service.api.connections import Connections
from needle_rig.service.api.endpoint import QUEUE
from needle_rig.service.api.orders import read_order
from needle_rig.service.api.serving import connection_limit, server
from needle_rig.web.asked import Lesson, RigModel, Work, read
from needle_rig.web.desk import Desk
from needle_rig.web.estimate import shaft_estimate
from needle_rig.web.expecting import Expecting
from needle_rig.web.glossary import glossary_html
from needle_rig.web.guard import LOOPBACK, SESSION, WATCHED_JOBS, WATCHES, Guard, Keys, Session, over_tls
from needle_rig.web.jobs import Jobs
from needle_rig.web.live import STOP_BYTES, live
from needle_rig.web.resident import Resident
from needle_rig.web.rig_link import ORDERS, RigLink
from needle_rig.web.run_index import RunIndex
from needle_rig.web.sources import NOTES_BYTES, Listed, Sources
from needle_rig.web.static_files import STATIC, KeptFiles, index, place
from needle_rig.web.store import Store
from needle_rig.web.uploads import NoRoom, TooMuch, Uploads, data_in, model_in
from needle_rig.workbench.contest.strategies_table import NEEDS_OTHERS

BODY_BYTES = 64 << 10
FILTER_LETTERS = 200
MOST_RUNS = 10**9
JOB_BYTES = 512 << 10
"""A mapping of some hundred channels, each with its reason."""
BODY_S = 10.0
CONNECTIONS = 256
"""Of strangers, and of those with the token: far more than pages of one person."""
OWN_DESCRIPTORS = 256
"""Files of jobs and uploads, and connections to the daemon."""

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
    own_rig: bool = False
    """Whether the rig was started for this page alone."""


class Page:
    """Everything behind the page: what lasts in `store`, what ends with the server below `folder`."""

    def __init__(self, settings: Settings, folder: Path, store: Store, unkept: str = "") -> None:
        self._settings, self._store, self._unkept = settings, store, unkept
        self.rig = RigLink(settings.socket, settings.own_rig)
        self.jobs = Jobs(store, folder)
        self.lessons = Resident(settings.effects)
        self.expecting = Resident(settings.effects)
        self.uploads = Uploads(store.folder / "uploads", lambda key: store.keep_upload(key, None))
        for key, kept in store.uploads().items():
            self.uploads.restore(key, **kept)
        self.sources = Sources(settings.data, settings.runs, self.uploads, RunIndex(store))
        self.desk = Desk(self.sources, self.jobs, store, settings.effects, settings.jobs)

    # the rig

    async def live(self, socket: WebSocket) -> None:
        """What the daemon tells, and stops to it."""
        await live(self.rig, socket)

    async def order(self, request: Request) -> Response:
        """One of the daemon's orders."""
        name = request.path_params["order"]
        if name not in ORDERS:
            raise HTTPException(404)
        content = read_order(name, await self._with_model(name, await body(request))).model_dump(
            exclude_none=True
        )
        return JSONResponse(await self.rig.order(name, content), 202)

    async def _with_model(self, name: str, content: bytes) -> bytes:
        """An order as it came; the key of a model becomes the model file, no word of one the rig's.

        Raises BadInput.
        """
        try:
            asked = json.loads(content or b"{}")
        except (ValueError, RecursionError):
            return content  # the order's record says what is wrong
        if not isinstance(asked, dict):
            return content
        if name == "compensate" and "model" not in asked:
            kept = await asyncio.to_thread(self.desk.rig_model)
            asked["model"] = None if kept is None else kept["key"]
        if not isinstance(asked.get("model"), str):
            return content
        text = await asyncio.to_thread(self.desk.model_text, asked["model"])
        return json.dumps(asked | {"model": text}).encode()

    async def rig_model(self, request: Request) -> Response:
        """Set the model that orders plan with where they name none."""
        asked = read(RigModel, await body(request))
        await asyncio.to_thread(self.desk.set_rig_model, asked.model)
        return JSONResponse({"rig_model": self.desk.rig_model()})

    async def estimate(self, request: Request) -> Response:
        """The matrix that gives the shaft's angle between its sensors."""
        rig: Any = as_mapping(await body(request))
        try:
            return JSONResponse(shaft_estimate(rig).as_json())
        except (KeyError, TypeError, ValueError, ArithmeticError):
            raise BadInput("this is no rig as the daemon tells it") from None

    # the workbench

    async def about(self, _: Request) -> Response:
        """What can be chosen: data, machines, models, strategies, parameter sets."""
        sources = await asyncio.to_thread(self.desk.named)
        return JSONResponse(
            {
                "data": [{"key": s.key, "name": s.name, "kind": s.kind} for s in sources],
                # what a recording may be of, if of no needle
                "machines": [{"key": key, "name": m.text} for key, m in MACHINES.items() if key != NEEDLE],
                "strategies": [
                    {"name": name, "text": sentence(kind)}
                    for name, kind in find_strategies().items()
                    if name not in NEEDS_OTHERS
                ],
                "models": [job.as_json() for job in self.jobs.models()],
                "rig_model": self.desk.rig_model(),
                "parameters": sorted(parameter_sets()),
                "runs": str(self._settings.runs),
                "unkept": self._unkept,
            }
        )

    async def begin_job(self, request: Request) -> Response:
        """Start a computation, or find that of the same question: its key."""
        asked = read(Work, await body(request, JOB_BYTES))
        given: Session = request.scope["state"][SESSION]
        if given.watches and asked.kind not in WATCHED_JOBS:
            raise HTTPException(403, WATCHES)
        job = await self.desk.begin(asked)
        return JSONResponse({"job": job.key}, 202)

    async def all_jobs(self, _: Request) -> Response:
        """What runs, and what was asked last: without the results."""
        return JSONResponse({"jobs": [job.as_json() for job in self.jobs.newest_asked()]})

    async def results(self, request: Request) -> Response:
        """The newest job of each kind that was asked of these data and this model."""
        asked = request.query_params
        found = await self.desk.results(asked.getlist("data"), asked.get("model") or None)
        return JSONResponse({kind: job.as_json() for kind, job in found.items()})

    async def job(self, request: Request) -> Response:
        """How far a computation is and what it found, or end it."""
        key = request.path_params["key"]
        job = self.jobs.cancel(key) if request.method == "DELETE" else self.jobs.get(key)
        told = json.dumps(job.as_json()).encode()
        result = await self.jobs.result(job) if job.state == "done" else b"null"
        return Response(told[:-1] + b', "result": ' + result + b"}", media_type="application/json")

    async def file(self, request: Request) -> Response:
        """A file that a job wrote, by its bare name."""
        key, name = request.path_params["key"], request.path_params["name"]
        job = self.jobs.find(key)
        folder = None if job is None or not job.folder.is_dir() else job.folder
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
        found.kind = "upload" if data else "model" if model is not None else "recording"
        kept = {
            "name": found.name,
            "kind": found.kind,
            "files": found.files,
            "bytes_taken": found.bytes_taken,
        }
        await asyncio.to_thread(self._store.keep_upload, key, kept)
        return JSONResponse({"files": len(found.files), "data": len(data), "model": model is not None}, 201)

    async def forget_upload(self, request: Request) -> Response:
        """Remove what was dropped."""
        await asyncio.to_thread(self.uploads.forget, request.path_params["key"])
        return JSONResponse({})

    # runs

    async def runs(self, request: Request) -> Response:
        """A page of the recorded runs with tags and notes, as the query sorts and filters them."""
        query = request.query_params
        start = query.get("start", "0")
        if not start.isascii() or not start.isdigit() or len(start) > len(str(MOST_RUNS)):
            raise BadInput("start: give the number of a run")
        asked = Listed(
            query.get("filter", "")[:FILTER_LETTERS],
            query.get("by", "started_utc")[:FILTER_LETTERS],
            query.get("down", "1") == "1",
            int(start),
        )
        return JSONResponse(await asyncio.to_thread(self.sources.run_documents, asked))

    async def run(self, request: Request) -> Response:
        """One recorded run with tags and note; a DELETE removes it."""
        name = request.path_params["name"]
        if request.method == "DELETE":
            await asyncio.to_thread(self.sources.remove_run, name)
            return JSONResponse({})
        return JSONResponse(await asyncio.to_thread(self.sources.run_document, name))

    # the session of a browser

    async def session(self, request: Request) -> Response:
        """Whether this browser is let in; a POST gives the two halves of a session for its other tabs."""
        given: Session = request.scope["state"][SESSION]
        if request.method == "GET":
            return JSONResponse({"watches": given.watches})
        answer = JSONResponse({"page": given.page, "watches": given.watches})
        tls = over_tls(request.headers)
        answer.set_cookie(given.cookie_name, given.cookie, httponly=True, samesite="strict", secure=tls)
        return answer

    async def watch(self, _: Request) -> Response:
        """What a person should know besides the state; empty where there is nothing.

        `contradiction` is what the newest run says against the model of the rig file, `version` that the
        daemon is of another version than the page.
        """
        said = await asyncio.to_thread(read_contradiction, self._settings.runs)
        return JSONResponse({"contradiction": said, "version": self.rig.other_version or ""})

    async def trends(self, _: Request) -> Response:
        """What the watch over the runs found: each parameter with its range, and alarms."""
        lags = await asyncio.to_thread(self.sources.index.lags, self.sources.runs)
        return JSONResponse(await self.lessons.ask("trends", directory=str(self.sources.runs), lags_deg=lags))

    async def notes(self, request: Request) -> Response:
        """Keep tags and a note beside a run."""
        content = await body(request, NOTES_BYTES)
        notes = await asyncio.to_thread(self.sources.keep_notes, request.path_params["name"], content)
        return JSONResponse(notes.model_dump())

    # effects

    async def effects(self, _: Request) -> Response:
        """The library, and the sentence of each own effect that cannot be used."""
        return JSONResponse(await self.lessons.ask("effects"))

    async def lesson(self, request: Request) -> Response:
        """One effect in the standard trial."""
        asked = read(Lesson, await body(request))
        data = asked.data
        path = None if data is None else (await asyncio.to_thread(self.sources.paths, [data]))[0]
        return JSONResponse(
            await self.lessons.ask("lesson", effect=asked.effect, values=asked.values, data=path)
        )

    async def openapi(self, _: Request) -> Response:
        """What this server answers, as OpenAPI."""
        return JSONResponse(await self.lessons.ask("openapi"))

    @contextlib.asynccontextmanager
    async def lifespan(self, _: Starlette) -> AsyncIterator[None]:
        """Listens to the daemon while the server runs."""
        self.rig.open()
        expecting = Expecting(self.rig, self.expecting, self.desk.model_of)
        following = asyncio.create_task(expecting.follow(), name="expecting")
        try:
            yield
        finally:
            following.cancel()
            await asyncio.gather(following, return_exceptions=True)
            self.expecting.close()
            await self.jobs.close()
            self.lessons.close()
            await asyncio.to_thread(self.sources.index.close)
            await self.rig.close()


def application(page: Page, port: int, keys: Keys, hosts: tuple[str, ...] = ()) -> Guard:
    """The whole server at `port`, guarded."""

    def put(path: str, answer: Callable[[Request], Awaitable[Response]], *methods: str) -> Route:
        return Route(path, answer, methods=list(methods))

    app = Starlette(
        routes=[
            WebSocketRoute("/api/live", page.live),
            put("/api/rig/{order}", page.order, "POST"),
            put("/api/rig_model", page.rig_model, "PUT"),
            put("/api/estimate", page.estimate, "POST"),
            put("/api/about", page.about, "GET"),
            put("/api/session", page.session, "GET", "POST"),
            put("/api/jobs", page.all_jobs, "GET"),
            put("/api/jobs", page.begin_job, "POST"),
            put("/api/results", page.results, "GET"),
            put("/api/jobs/{key}", page.job, "GET", "DELETE"),
            put("/api/jobs/{key}/{name}", page.file, "GET"),
            put("/api/uploads", page.begin_upload, "POST"),
            put("/api/uploads/{key}", page.forget_upload, "DELETE"),
            put("/api/uploads/{key}/{path:path}", page.upload, "PUT"),
            put("/api/runs", page.runs, "GET"),
            put("/api/runs/{name}", page.run, "GET", "DELETE"),
            put("/api/watch", page.watch, "GET"),
            put("/api/trends", page.trends, "GET"),
            put("/api/runs/{name}/notes", page.notes, "PUT"),
            put("/api/effects", page.effects, "GET"),
            put("/api/lesson", page.lesson, "POST"),
            put("/api/openapi", page.openapi, "GET"),
            put("/glossary.html", glossary, "GET"),
            put("/", index, "GET"),
            Mount(place(), KeptFiles(directory=STATIC)),
        ],
        exception_handlers={NeedleRigError: refuse, HTTPException: refuse_path},
        lifespan=page.lifespan,
    )
    return Guard(app, port, keys, hosts)


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


async def refuse(_: Request, error: Exception) -> Response:
    """A sentence for the page."""
    assert isinstance(error, NeedleRigError)
    kinds = ((TooMuch, 413), (NoRoom, 507), (Aborted, 409), (RigFault, 503))
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


async def serve(
    page: Page, listener: sockets.socket, keys: Keys, hosts: tuple[str, ...], ready: Callable[[], None]
) -> None:
    """Serve until SIGINT or SIGTERM."""
    connections = Connections(
        listener, connection_limit(CONNECTIONS, OWN_DESCRIPTORS), timed_by_application=True
    )
    served = server(
        application(page, listener.getsockname()[1], keys, hosts),
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
