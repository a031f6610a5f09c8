"""Every install command that is printed can be typed: it names what there is, from where it is said."""

from __future__ import annotations

import importlib.metadata
import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
import venv
from pathlib import Path
from typing import Any

import pytest

from needle_rig import extras
from needle_rig.errors import BadInput

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = sorted(PROJECT["optional-dependencies"])
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "firmware/README.md",
    *(p for p in sorted((ROOT / "docs").rglob("*.md")) if "evidence" not in p.parts),
]
SOURCES = [
    *sorted((ROOT / "needle_rig").rglob("*.py")),
    *(p for p in (ROOT / "scripts").iterdir() if p.is_file()),
    *sorted((ROOT / "campaigns").rglob("*.py")),
    *sorted((ROOT / "benchmarks").rglob("*.py")),
]
_COMMAND = re.compile(
    r"""pip install ((?:-\S+ (?:requirements\S* )?)*(?:'\.\[\w+\]'|\.\[\w+\]|\.))(?=[\s`|"]|$)""", re.M
)


def printed() -> list[str]:
    """What follows `pip install` on all pages and in all scripts that install this project."""
    texts = [path.read_text(encoding="utf-8") for path in [*PAGES, *SOURCES]]
    return sorted({command[1] for text in texts for command in _COMMAND.finditer(text)})


def metadata(monkeypatch: pytest.MonkeyPatch, origin: dict[str, Any] | None) -> None:
    """As if the package was installed from `origin`, what pip keeps in direct_url.json."""

    class Distribution:
        def read_text(self, _: str) -> str | None:
            return None if origin is None else json.dumps(origin)

    monkeypatch.setattr(extras, "_SOURCE", Path("/nowhere"))
    monkeypatch.setattr(importlib.metadata, "distribution", lambda _: Distribution())
    requires = [
        *(f"{p}" for p in PROJECT["dependencies"]),
        *(f'{p}; extra == "{e}"' for e in EXTRAS for p in PROJECT["optional-dependencies"][e]),
    ]
    monkeypatch.setattr(importlib.metadata, "requires", lambda _: requires)


def test_every_printed_command_is_of_a_clone_and_names_an_extra_there_is() -> None:
    commands = printed()
    assert len(commands) > 8
    for command in commands:
        words = shlex.split(command)
        assert words[:2] == ["-c", "requirements.lock"], command
        assert words[2:-1] in ([], ["-e"]), command
        of = re.fullmatch(r"\.(?:\[(?P<extra>[a-z]+)\])?", words[-1])
        assert of, command
        assert of["extra"] is None or of["extra"] in EXTRAS, command


def test_every_package_that_is_named_is_pinned() -> None:
    pinned = set(re.findall(r"(?m)^([a-z0-9-]+)==", (ROOT / "requirements.lock").read_text(encoding="utf-8")))
    named = [*PROJECT["dependencies"], *(p for e in EXTRAS for p in PROJECT["optional-dependencies"][e])]
    names = {re.split(r"[\[>=;]", name)[0].strip().lower() for name in named} - {extras.NAME}
    assert names <= pinned, names - pinned


def test_nobody_is_sent_to_an_index_for_this_project() -> None:
    for path in [*PAGES, *SOURCES]:
        assert not re.search(r"install[^\n]*['\" ]needle-rig\[", path.read_text(encoding="utf-8")), path


def test_every_extra_that_is_asked_for_is_one() -> None:
    asked = set()
    for path in SOURCES:
        text = path.read_text(encoding="utf-8")
        asked |= {m[1] for m in re.finditer(r'(?:needed|missing)\([^\n]*, "([a-z]+)"\)', text)}
        asked |= {m[1] for m in re.finditer(r"install_(?:command|arguments)\(['\"]([a-z]+)['\"]\)", text)}
    assert {"import", "figures", "mcap", "bench", "cluster", "pysr", "dev"} <= asked <= set(EXTRAS)


def test_in_a_clone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(ROOT)
    assert extras.install_arguments("import") == "-c requirements.lock -e '.[import]'"
    monkeypatch.chdir(tmp_path)
    assert extras.install_arguments("import") == f"-c {ROOT}/requirements.lock -e '{ROOT}[import]'"


def test_installed_from_a_clone_that_is_still_there(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    metadata(monkeypatch, {"url": ROOT.as_uri(), "dir_info": {}})
    monkeypatch.chdir(ROOT)
    assert extras.install_arguments("figures") == "-c requirements.lock '.[figures]'"
    assert extras.install_arguments() == "-c requirements.lock ."
    metadata(monkeypatch, {"url": (tmp_path / "gone").as_uri(), "dir_info": {}})
    assert extras.install_arguments("figures") == "'matplotlib>=3.8'"


@pytest.mark.parametrize("origin", [None, {"url": "file:///x/needle_rig.whl", "archive_info": {}}])
def test_from_a_wheel_an_extra_is_its_packages(origin: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    metadata(monkeypatch, origin)
    assert extras.install_arguments("import") == (
        "'asammdf>=8.0' 'mat-io>=1.0' 'mcap>=1.1' 'nptdms>=1.7' 'polars>=1.0' 'python-calamine>=0.4'"
        " 'rosbags>=0.11'"
    )
    for extra in EXTRAS:
        words = shlex.split(extras.install_arguments(extra))
        assert words
        assert not any(word.startswith(("needle-rig", ".")) for word in words)


def test_the_sentence_names_use_package_and_command() -> None:
    with pytest.raises(BadInput, match=r"^a kite needs the package no-such-thing, which .*pip "):
        extras.needed("no_such_thing.inner", "a kite", "import")
    assert extras.needed("json", "text", "import") is json


WITHOUT = """
import sys
for name in {blocked!r}:
    sys.modules[name] = None
from needle_rig.cli.main import run
sys.exit(run({arguments!r}))
"""


def without(packages: tuple[str, ...], folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """A command where packages of extras are not installed."""
    return subprocess.run(
        [sys.executable, "-c", WITHOUT.format(blocked=packages, arguments=list(arguments))],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )


BASE = (
    *("asammdf", "matio", "mcap", "nptdms", "polars", "python_calamine", "rosbags"),
    *("matplotlib", "pandas", "ziglang", "cffi"),
)


@pytest.mark.whole
def test_a_base_installation_reads_a_csv(tmp_path: Path) -> None:
    turned = [0.9 * max(0, min(k - 30, 50)) for k in range(120)]
    rows = "\n".join(f"{k * 20};{b:.2f};{0.8 * b:.2f}".replace(".", ",") for k, b in enumerate(turned))
    (tmp_path / "log.csv").write_text(f"Time [ms];Base [deg];Tip [deg]\n{rows}\n", encoding="utf-8")
    (tmp_path / "shaft.yaml").write_text(
        "needle: {diameter_mm: 0.39, shear_modulus_gpa: 27.2}\nneedle_length_mm: 397\n"
        "tissue_sections_mm: [[175, 200]]\nhall_sensors: [{name: tip, position_mm: 396}]\n",
        encoding="utf-8",
    )
    line = ("import", "log.csv", "--guess", "--layout", "shaft.yaml", "--yes", "--out", "mine")
    done = without(BASE, tmp_path, *line)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "mine" / "dataset.yaml").is_file()
    assert "no picture: a picture needs the package matplotlib" in done.stderr


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (("layout", "none.yaml", "--png", "x.png"), "a picture needs the package matplotlib"),
        (("compare", "none", "--pictures", "x"), "a picture needs the package matplotlib"),
        (("demo", "--pictures", "x"), "a picture needs the package matplotlib"),
        (("reproduce", "--html", "x.html"), "a picture needs the package matplotlib"),
        (("firmware", "build"), "building the firmware (the compiler) needs the package ziglang"),
    ],
)
def test_an_extra_is_asked_for_before_the_work(line: tuple[str, ...], says: str, tmp_path: Path) -> None:
    done = without(BASE, tmp_path, *line)
    assert done.returncode == 2
    assert done.stderr.startswith(says), done.stderr
    assert "install -c " in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("command", printed())
def test_pip_takes_the_printed_command(command: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "pip", "install", "--dry-run", "--quiet", *shlex.split(command)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_pip_takes_what_a_wheel_prints(tmp_path: Path) -> None:
    build = "import sys; from hatchling.build import build_wheel; print(build_wheel(sys.argv[1]))"
    line = [sys.executable, "-c", build, str(tmp_path)]
    name = subprocess.run(line, cwd=ROOT, check=True, capture_output=True, text=True).stdout.split()[-1]
    venv.create(tmp_path / "venv", with_pip=True)
    python = str(tmp_path / "venv" / "bin" / "python")
    quiet = ["-m", "pip", "install", "--quiet"]
    subprocess.run([python, *quiet, "--no-deps", str(tmp_path / name)], check=True)
    for extra in ("figures", "import", "mcap", "bench", "cluster"):
        ask = f"from needle_rig.extras import install_arguments as a; print(a({extra!r}))"
        told = subprocess.run([python, "-c", ask], cwd=tmp_path, capture_output=True, text=True, check=True)
        wanted = shlex.split(told.stdout)
        done = subprocess.run(
            [python, *quiet, "--dry-run", *wanted], cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, (told.stdout, done.stderr[-2000:])
