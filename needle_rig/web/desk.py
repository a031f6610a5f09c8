"""The workbench as the server keeps it: what may be asked of which data and model, and who answers."""

from __future__ import annotations

import asyncio
import json
from contextlib import suppress
from pathlib import Path
from typing import Any

from needle_rig.errors import BadInput
from needle_rig.model import parameter_sets
from needle_rig.recording import changed_in
from needle_rig.web.asked import Work
from needle_rig.web.identity import data_hash, file_hash, model_hash, question_text
from needle_rig.web.jobs import Job, Jobs, Subject
from needle_rig.web.places import COMPARISON, DATASET, DATASET_KINDS, DIAGNOSIS, MODEL
from needle_rig.web.sources import Source, Sources, free_name
from needle_rig.web.store import RIG_MODEL, Store, sealed
from needle_rig.web.uploads import Uploads, model_in

OF_A_MODEL = ("compare", "diagnose", "take_values", "undo", "strategies", "learn", "add_effect")
OF_DATA = ("compare", "diagnose", "take_values", "adopt", "show", "export", "learn", "add_effect")
"""Kinds of work that are given a model or none, and that are given data."""
OF_VALUES = ("refit", "fixed", "free")
"""Fields of a comparison, which its record checks."""
EXAMPLE = {"parameters": "rig_elastic", "name": "example"}
"""What is simulated for those without data: the simulated rig's needle, whose tissue yields."""
SHOWN = (
    "quick",
    *OF_VALUES,
    "what",
    "form",
    "targets_deg",
    "seeds",
    "parameters",
    "upload",
    "chosen",
    "effect",
    "compared",
)
"""Fields of a question that the page shows again."""

Document = dict[str, Any]


class Desk:
    """Questions in, jobs out."""

    def __init__(
        self, sources: Sources, jobs: Jobs, store: Store, effects: tuple[str, ...], processes: int
    ) -> None:
        self._sources, self._jobs, self._store = sources, jobs, store
        self._effects, self._processes = effects, processes
        for job in jobs.all():
            self._know(job)

    @property
    def _uploads(self) -> Uploads:
        return self._sources.uploads

    def _know(self, job: Job) -> None:
        """An import is data from its beginning, so that it can be named; it is read once it ended."""
        if job.of.kind in DATASET_KINDS and job.state != "failed":
            self._sources.imported[f"imported:{job.key}"] = job.folder / DATASET

    async def begin(self, asked: Work) -> Job:
        """The job that answers this: a new one, or that of the same question. Raises BadInput."""
        kind = asked.kind
        given: Document = {}
        data: list[str] = []
        if kind in OF_DATA:
            data = await asyncio.to_thread(self._sources.paths, asked.data)
            given["data"] = data
        model = self._model(asked.model) if kind in OF_A_MODEL else None
        if kind in OF_A_MODEL:
            given["model"] = model
        question: Document = {
            name: getattr(asked, name) for name in asked.model_fields_set - {"kind", "data", "model"}
        }
        drafts = self._drafts_of(asked.model, asked.diagnosis)
        draft = ""
        if kind == "compare":
            given |= {name: question[name] for name in OF_VALUES if name in question}
        elif kind == "figure":
            given |= self._figure(asked)
        elif kind == "watch":
            given |= {"directory": str(self._sources.runs), "effects": list(self._effects)}
            # runs that came since are another question
            question["runs"] = sorted(await asyncio.to_thread(changed_in, self._sources.runs))[-1:]
        elif kind == "report":
            given |= await self._report(asked)
        elif kind == "open":
            upload = self._uploads.get(str(asked.upload))
            if (dropped := model_in(upload.folder)) is None:
                raise BadInput(f"{upload.name}: holds no model file")
            given["model"] = str(dropped)
        elif kind == "diagnose":
            given["quick"] = asked.quick
        elif kind == "adopt":
            given["diagnosis"] = self._file(asked.diagnosis, DIAGNOSIS)
            given["chosen"] = asked.chosen
        elif kind == "learn":
            draft = f"learnt_law_{1 + sum(job.of.kind == 'learn' for job in self._jobs.all())}.py"
        elif kind == "add_effect":
            given["effect"] = str(asked.effect)
            if asked.learnt is not None:
                learnt = self._jobs.find(asked.learnt)
                if learnt is None or not learnt.folder.is_dir():
                    raise BadInput("what was learnt is not there any more; learn it again")
                drafts = (*drafts, learnt.key)
        elif kind == "undo" and given["model"] is None:
            raise BadInput("there is no step to take back")
        elif kind == "export":
            given["form"] = str(asked.form)
        elif kind == "chart":
            if asked.chart is None:
                raise BadInput("there is no chart to draw; open the page again")
            given["chart"] = question["chart"] = asked.chart.model_dump()
        elif kind == "strategies":
            given |= _contest(asked, given["model"])
        elif kind in ("guess", "import"):
            given |= self._recordings(asked)
            if kind == "guess":
                given["layout"] = await self._layout(asked)
                given["machine"] = asked.machine
        elif kind == "example":
            given |= EXAMPLE
        elif "data" not in given and kind != "undo":
            raise BadInput("this is no computation that the page knows")
        effects = [*self._effects, *self._folders(drafts)]
        if kind in (*OF_A_MODEL, "adopt", "open"):
            given["effects"] = effects
        names = {source.key: source.name for source in await asyncio.to_thread(self.named)}
        keys = [f"upload:{asked.upload}"] if asked.upload is not None else asked.data
        subject = Subject(
            kind,
            tuple((key, names.get(key, key.partition(":")[2])) for key in keys),
            None if asked.model is None else (asked.model, self.name_of(asked.model)),
            question_text(kind, question),
            await self._hashes(self._content(keys, data), model, effects),
            {name: value for name, value in question.items() if name in SHOWN},
            tuple(dict.fromkeys(drafts)),
        )
        if (same := self._jobs.same(subject)) is not None:
            return same
        key, folder = self._jobs.new(subject)
        if draft:
            given["draft"] = str(folder / draft)
        if isinstance(given.get("layout"), bytes):
            folder.mkdir(parents=True)
            (folder / "layout.yaml").write_bytes(given["layout"])
            given["layout"] = str(folder / "layout.yaml")
        job = self._jobs.start(key, subject, {**given, "jobs": self._processes})
        self._know(job)
        return job

    def named(self) -> list[Source]:
        """All data that can be chosen, but for runs; each name once."""
        found = self._sources.named()
        taken = {source.name for source in found}
        for job in self._jobs.all():
            if job.of.kind in DATASET_KINDS and job.state == "done":
                name = free_name(job.name, taken)
                found.append(
                    Source(
                        f"imported:{job.key}",
                        name,
                        "example" if job.of.kind == "example" else "imported",
                        (job.folder / DATASET,),
                    )
                )
        return found

    async def results(self, data: list[str], model: str | None) -> dict[str, Job]:
        """By kind, the newest that was asked of these data and this model. Raises BadInput."""
        recordings = [key for key in data if self._is_recording(key)]
        paths = [] if recordings or not data else await asyncio.to_thread(self._sources.paths, data)
        paths = self._content(data, paths)
        effects = [*self._effects, *self._folders(self._drafts_of(model))]
        return self._jobs.newest(await self._hashes(paths, self._model(model), effects))

    async def _hashes(self, data: list[str], model: str | None, effects: list[str]) -> tuple[str, str]:
        try:
            return await asyncio.to_thread(data_hash, data), await asyncio.to_thread(
                model_hash, model, effects
            )
        except OSError as error:
            raise BadInput(f"the data cannot be read ({error.strerror}); choose others") from None

    def _is_recording(self, key: str) -> bool:
        kind, _, rest = key.partition(":")
        return kind == "upload" and self._uploads.get(rest).kind == "recording"

    def _content(self, keys: list[str], paths: list[str]) -> list[str]:
        """What is read for these keys: of recordings all that was dropped."""
        dropped = [self._uploads.get(key.partition(":")[2]).folder for key in keys if self._is_recording(key)]
        return [*paths, *(str(folder) for folder in dropped)]

    def name_of(self, model: str) -> str:
        """What a person calls the model of this key."""
        job = self._jobs.find(model)
        return model if job is None else job.name

    def _drafts_of(self, *keys: object) -> tuple[str, ...]:
        """The jobs whose learnt laws are in what these jobs made."""
        found = [job for key in keys if (job := self._jobs.find(key)) is not None]
        return tuple(dict.fromkeys(key for job in found for key in job.of.drafts))

    def _folders(self, drafts: tuple[str, ...]) -> list[str]:
        """Folders of learnt laws: Python that this user's own server wrote, and nobody else."""
        folders = []
        for key in drafts:
            job = self._jobs.find(key)
            if job is None or not job.folder.is_dir():
                raise BadInput("the law of this model is not there any more; learn it again")
            if not sealed(job.folder):
                raise BadInput("the law of this model was not learnt by you on this computer; learn it again")
            folders.append(str(job.folder))
        return folders

    def _figure(self, asked: Work) -> Document:
        """The comparison that was kept, and its question to compare again after a restart."""
        job = self._jobs.find(asked.compared)
        if job is None or job.of.kind != "compare":
            raise BadInput("what this builds on is not there any more; compute it again")
        again: Document = {
            "data": self._sources.paths([key for key, _ in job.of.data]),
            "model": self._model(None if job.of.model is None else job.of.model[0]),
            "effects": [*self._effects, *self._folders(job.of.drafts)],
            **{name: value for name, value in job.of.asked.items() if name in OF_VALUES},
        }
        return {"comparison": str(job.folder / COMPARISON), "what": str(asked.what), "again": again}

    async def _report(self, asked: Work) -> Document:
        """A diagnosis that was answered, and the comparison whose pictures go with it."""
        job = self._jobs.find(asked.diagnosis)
        if job is None or job.of.kind != "diagnose" or job.state != "done":
            raise BadInput("this diagnosis is not there any more; diagnose again")
        told = json.loads(await self._jobs.result(job))
        del told["candidates"]  # its traces are megabytes, and no part of the report
        given = self._figure(asked)
        question = {**given["again"], "quick": told["quick"]}
        for name in OF_VALUES:
            question.pop(name, None)
        return {
            "told": told,
            "diagnosis": self._file(asked.diagnosis, DIAGNOSIS),
            "comparison": given["comparison"],
            "again": given["again"],
            "question": question,
        }

    def _recordings(self, asked: Work) -> Document:
        """An upload of recordings, with its mapping or with its name."""
        upload = self._uploads.get(str(asked.upload))
        files = [file for file in sorted(upload.files) if (upload.folder / file).is_file()]
        given: Document = {"folder": str(upload.folder), "files": files}
        return given | ({"mapping": asked.mapping} if asked.kind == "import" else {"name": upload.name})

    async def _layout(self, asked: Work) -> str | bytes | None:
        """Where the shaft of a guess is read: lines that a person wrote, or other data."""
        if asked.layout is not None and asked.layout.strip():
            return asked.layout.encode()
        if asked.layout_of is None:
            return None
        return (await asyncio.to_thread(self._sources.paths, [asked.layout_of]))[0]

    def model_text(self, key: str) -> str:
        """The text of a model file of the library, for an order to the rig. Raises BadInput."""
        if key in parameter_sets():
            raise BadInput(f"{key}: is a published parameter set; choose a model that was learnt on this rig")
        path = self._file(key, MODEL)
        assert path is not None
        return Path(path).read_text(encoding="utf-8")

    def set_rig_model(self, key: str | None) -> None:
        """Let orders plan with the model of this key where they name none. Raises BadInput."""
        if key is not None:
            self.model_text(key)
        self._store.keep_setting(RIG_MODEL, None if key is None else {"key": key, "name": self.name_of(key)})

    def rig_model(self) -> Document | None:
        """Key and name of that model; None where nobody set one."""
        return self._store.setting(RIG_MODEL)

    def model_of(self, sha256: str) -> tuple[str, list[str]] | None:
        """The model file of the library with this hash, and the folders of its effects; None for another."""
        for job in self._jobs.models():
            path = job.folder / MODEL
            with suppress(OSError, BadInput):
                if file_hash(path).hex() == sha256:
                    return str(path), [*self._effects, *self._folders(job.of.drafts)]
        return None

    def _model(self, key: str | None) -> str | None:
        """The model that a job made, or the name of a parameter set; None for the null model."""
        return key if key in parameter_sets() else self._file(key, MODEL)

    def _file(self, key: str | None, name: str) -> str | None:
        """The file of this name that a job made; None for no key."""
        if key is None:
            return None
        job = self._jobs.find(key)
        path = Path() if job is None else job.folder / name
        if not path.is_file():
            raise BadInput("what this builds on is not there any more; compute it again")
        return str(path)


def _contest(asked: Work, model: str | None) -> Document:
    """Targets, runs, and the rig that planned knows: what was learnt, or else a parameter set."""
    if asked.targets_deg is None or asked.seeds is None or asked.parameters not in parameter_sets():
        raise BadInput("give targets in degrees, a number of runs, and a parameter set of the list")
    rig = model or asked.parameters
    return {"targets_deg": asked.targets_deg, "seeds": asked.seeds, "parameters": rig, "model": rig}
