"""The kinds of file and request that `fuzz_files` damages, and the commands that then read them."""

from __future__ import annotations

import json
import random
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path

from campaigns import ROOT
from campaigns.files import file_mutations as damage
from needle_rig.cli.main import run as command
from needle_rig.config.files import find_config_file
from needle_rig.config.loader import load_rig_config
from needle_rig.control.brain import Brain
from needle_rig.control.reports import Request
from needle_rig.errors import NeedleRigError
from needle_rig.firmware.pages import drive_page, read_page, write_page
from needle_rig.recording import RunFile
from needle_rig.service.api.orders import Order, read_order
from needle_rig.units import rad

PROTOCOL = """\
format: needle-rig-protocol/1
name: mini
pause_s: 5
trials:
  - {kind: compensate, target_deg: 45, speed_deg_s: 45, settle_s: 1}
  - {kind: compensate, target_deg: -45, speed_deg_s: 45, settle_s: 1}
  - {kind: staircase, steps_deg: [15, 30, 0], speed_deg_s: 30, settle_s: 1}
"""
ORDER = {
    "target_deg": 45,
    "strategy": "protocol",
    "options": {"steps_deg": [10, 20]},
    "settle_s": 1.0,
    "speed_deg_s": 30.0,
    "lag_left_deg": 1.0,
}
DEVICE = "amplifier.py"
DEVICE_PAGE = ROOT / "docs/how-to/own-device.md"
"""Its one Python block is a device."""
NO_FILE = 0.08
"""Share of the mutations that put a pipe, a link, a device … where the file was."""
SLOW = 20
"""Each so many mutations of a rig file, one starts a daemon with it, which takes two seconds."""

Action = tuple[str, Callable[[], int]]
Mutate = Callable[[bytes, random.Random], tuple[str, bytes]]


@dataclass(frozen=True)
class Seeds:
    """Good files, and a folder in which each mutation finds a place of its own."""

    folder: Path
    effect: Path

    def make(self) -> None:
        """Write the good files: a dataset, a run, a model and what they are made of."""
        self.folder.mkdir(parents=True)
        (self.folder / "protocol.yaml").write_text(PROTOCOL, encoding="utf-8")
        for name in ("rig.yaml", "parameters/rig_elastic.yaml", "datasets/reed2008/settled.yaml"):
            shutil.copy(find_config_file(name), self.folder)
        shutil.copy(self.effect, self.folder)
        device = DEVICE_PAGE.read_text(encoding="utf-8").split("```python\n")[1].split("```")[0]
        (self.folder / DEVICE).write_text(device, encoding="utf-8")
        write_page(self.folder / "drive.hex", drive_page(360_000, 7, date(2026, 1, 1)))
        for line in (
            f"simulate --effect tissue_elasticity=0.35 --protocol {self.folder}/protocol.yaml --rate-hz 20"
            f" --out {self.folder}/dataset",
            f"adopt {self.folder}/dataset tissue_elasticity --out {self.folder}/model.yaml",
            f"compensate --target 20 --fast --settle 0.5 --strategy none --json --out {self.folder}/runs",
        ):
            if command(line.split()) != 0:
                raise SystemExit(f"needle-rig {line}: failed, so there is nothing to damage")
        next((self.folder / "runs").glob("*.h5")).rename(self.folder / "run.h5")

    def warm(self, out: Path) -> bool:
        """Whether commands read the good files, which loads what their forks need."""
        run = self.folder / "run.h5"
        dataset = self.folder / "dataset"
        out.mkdir()
        commands: tuple[Sequence[str | Path], ...] = (
            ["compare", dataset, "--model", self.folder / "model.yaml"],
            ["compare", self.folder / "settled.yaml"],
            ["compare", run],
            [
                "simulate",
                "--protocol",
                self.folder / "protocol.yaml",
                "--rate-hz",
                "20",
                "--out",
                out / "made",
            ],
            ["effects"],
            *(
                ("export", run, f"--{kind}", "--out", out / kind)
                for kind in ("csv", "mcap", "png", "dataset")
            ),
        )
        return all(command([str(word) for word in words]) == 0 for words in commands)


def kinds() -> dict[str, tuple[int, Callable[[Seeds, Path, random.Random, int], tuple[str, list[Action]]]]]:
    """By name: how many mutations the whole campaign makes, and what makes one of them in an empty folder."""
    return {
        "trial CSV": (250, _trial),
        "dataset.yaml": (250, _dataset),
        "model": (200, _model),
        "settled.yaml": (150, _settled),
        "protocol": (200, _protocol),
        "rig file": (200, _rig),
        "parameters": (150, _parameters),
        "effect": (150, _effect),
        "device": (250, _device),
        "calibration page": (150, _page),
        "request": (400, _request),
        "run: a bit": (1000, _run_bit),
        "run: cut": (500, _run_cut),
        "run: tables": (500, _run_tables),
    }


def _cli(*words: str | Path) -> Action:
    texts = [str(word) for word in words]
    return texts[0], lambda: command(texts)


def _damaged(source: Path, target: Path, mutate: Mutate, rng: random.Random) -> str:
    """Puts a damaged copy of `source` at `target`, or something that is no file."""
    target.unlink(missing_ok=True)
    if rng.random() < NO_FILE:
        return damage.no_file(target, rng)
    how, content = mutate(source.read_bytes(), rng)
    target.write_bytes(content)
    return how


def _in_dataset(
    seeds: Seeds, here: Path, file: str, mutate: Mutate, rng: random.Random
) -> tuple[str, list[Action]]:
    shutil.copytree(seeds.folder / "dataset", here / "dataset")
    how = _damaged(seeds.folder / "dataset" / file, here / "dataset" / file, mutate, rng)
    return how, [_cli("compare", here / "dataset")]


def _trial(seeds: Seeds, here: Path, rng: random.Random, number: int) -> tuple[str, list[Action]]:
    return _in_dataset(seeds, here, f"trials/0{1 + number % 3}.csv", damage.damaged_csv, rng)


def _dataset(seeds: Seeds, here: Path, rng: random.Random, number: int) -> tuple[str, list[Action]]:
    how, actions = _in_dataset(seeds, here, "dataset.yaml", damage.damaged_yaml, rng)
    return how, [*actions, _cli("layout", here / "dataset")]


def _model(seeds: Seeds, here: Path, rng: random.Random, number: int) -> tuple[str, list[Action]]:
    how = _damaged(seeds.folder / "model.yaml", here / "model.yaml", damage.damaged_yaml, rng)
    return how, [_cli("compare", seeds.folder / "dataset", "--model", here / "model.yaml")]


def _settled(seeds: Seeds, here: Path, rng: random.Random, number: int) -> tuple[str, list[Action]]:
    how = _damaged(seeds.folder / "settled.yaml", here / "settled.yaml", damage.damaged_yaml, rng)
    return how, [_cli("compare", here)]


def _simulate(here: Path, *words: str | Path) -> Action:
    return _cli("simulate", *words, "--rate-hz", "20", "--out", here / "out")


def _protocol(seeds: Seeds, here: Path, rng: random.Random, number: int) -> tuple[str, list[Action]]:
    how = _damaged(seeds.folder / "protocol.yaml", here / "p.yaml", damage.damaged_yaml, rng)
    return how, [_simulate(here, "--protocol", here / "p.yaml")]


def _parameters(seeds: Seeds, here: Path, rng: random.Random, number: int) -> tuple[str, list[Action]]:
    how = _damaged(seeds.folder / "rig_elastic.yaml", here / "p.yaml", damage.damaged_yaml, rng)
    return how, [
        _simulate(here, "--parameters", here / "p.yaml", "--protocol", seeds.folder / "protocol.yaml")
    ]


def _rig(seeds: Seeds, here: Path, rng: random.Random, number: int) -> tuple[str, list[Action]]:
    how = _damaged(seeds.folder / "rig.yaml", here / "rig.yaml", damage.damaged_yaml, rng)
    if number % SLOW:
        return how, [_cli("runs", "--config", here / "rig.yaml")]
    words = f"compensate --target 20 --fast --strategy none --json --out {here}/runs --config {here}/rig.yaml"
    return how, [_cli(*words.split())]


def _effect(seeds: Seeds, here: Path, rng: random.Random, number: int) -> tuple[str, list[Action]]:
    name = seeds.effect.stem
    how = _damaged(seeds.effect, here / seeds.effect.name, damage.damaged_bytes, rng)
    used = _simulate(here, "--effects", here, "--effect", name, "--protocol", seeds.folder / "protocol.yaml")
    return how, [_cli("effects", name, "--effects", here), *([] if number % 2 else [used])]


def _device(seeds: Seeds, here: Path, rng: random.Random, number: int) -> tuple[str, list[Action]]:
    how = _damaged(seeds.folder / DEVICE, here / DEVICE, damage.damaged_bytes, rng)
    return how, [_cli("check-device", here / DEVICE, "port=/dev/ttyUSB0")]


def _page(seeds: Seeds, here: Path, rng: random.Random, number: int) -> tuple[str, list[Action]]:
    how = _damaged(seeds.folder / "drive.hex", here / "drive.hex", damage.damaged_bytes, rng)
    return how, [("read_page", _judged(lambda: read_page(here / "drive.hex")))]


def _request(seeds: Seeds, here: Path, rng: random.Random, number: int) -> tuple[str, list[Action]]:
    how, body = damage.damaged_json(json.dumps(ORDER).encode(), rng)
    return how, [("POST /compensate", _judged(lambda: _ask(body)))]


def _run_bit(seeds: Seeds, here: Path, rng: random.Random, number: int) -> tuple[str, list[Action]]:
    how, content = damage.flipped_bit((seeds.folder / "run.h5").read_bytes(), rng, number)
    (here / "run.h5").write_bytes(content)
    return how, _read_run(here / "run.h5", number)


def _run_cut(seeds: Seeds, here: Path, rng: random.Random, number: int) -> tuple[str, list[Action]]:
    how, content = damage.cut_run((seeds.folder / "run.h5").read_bytes(), rng, number)
    (here / "run.h5").write_bytes(content)
    return how, _read_run(here / "run.h5", number)


def _run_tables(seeds: Seeds, here: Path, rng: random.Random, number: int) -> tuple[str, list[Action]]:
    path = here / "run.h5"
    if rng.random() < NO_FILE:
        return damage.no_file(path, rng), _read_run(path, number)
    shutil.copy(seeds.folder / "run.h5", path)
    return damage.other_tables(path, rng), _read_run(path, number)


def _read_run(path: Path, number: int) -> list[Action]:
    """The list of the folder, the whole file in Python, and in turn an export, a comparison or the watch."""
    out = path.parent / "out"
    in_turn = (
        _cli("export", path, "--csv", "--out", out),
        _cli("export", path, "--mcap", "--out", out),
        _cli("export", path, "--picture", "--out", out),
        _cli("export", path, "--dataset", "--out", out),
        _cli("compare", path),
        _cli("watch", "--dir", path.parent),
    )[number % 6]
    return [_cli("runs", "--dir", path.parent), ("RunFile", _judged(lambda: _whole(path))), in_turn]


def _whole(path: Path) -> Iterator[object]:
    run = RunFile(path)
    return iter([run.ending(), run.events, *(run.table(name) for name in run.tables), run.config])


def _ask(body: bytes) -> None:
    order = read_order("compensate", body)
    assert isinstance(order, Order)
    Brain(load_rig_config()).compensate(
        Request(
            target_rad=rad(order.target_deg),
            strategy=order.strategy,
            options=order.options,
            settle_s=order.settle_s,
            speed_rad_s=None if order.speed_deg_s is None else rad(order.speed_deg_s),
            lag_left_rad=None if order.lag_left_deg is None else rad(order.lag_left_deg),
        )
    )


def _judged(ask: Callable[[], object]) -> Callable[[], int]:
    """`ask` as a command: the exit code of what it raises, which a person would read."""

    def judged() -> int:
        try:
            ask()
        except NeedleRigError as error:
            print(error)
            return error.exit_code
        return 0

    return judged
