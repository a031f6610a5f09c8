"""What a release, a citation and the checks of others rest on says the same everywhere."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

from needle_rig.version import VERSION

ROOT = Path(__file__).parents[2]
PYPROJECT = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
SETTINGS = tomllib.loads(PYPROJECT)
MOST_LINES = 200


def text(path: str) -> str:
    return (ROOT / path).read_text(encoding="utf-8")


def of_yaml(path: str) -> Any:
    return yaml.safe_load(text(path))


def test_pyproject_is_read_in_one_go() -> None:
    assert len(PYPROJECT.splitlines()) < MOST_LINES


def test_the_version_stands_in_one_place_which_the_release_page_names() -> None:
    place = SETTINGS["tool"]["hatch"]["version"]["path"]
    assert f'VERSION = "{VERSION}"' in text(place)
    assert "version" not in SETTINGS["project"]
    assert f"The version in `{place}`" in text("CONTRIBUTING.md")
    assert text("CHANGELOG.md").splitlines()[2].startswith(f"## {VERSION}, ")


def test_python_without_its_ending_is_nowhere() -> None:
    """Ruff, mypy and vulture look at *.py: what lacks the ending would be looked at by none."""
    unseen = [
        path
        for folder in ("benchmarks", "campaigns", "scripts")
        for path in (ROOT / folder).rglob("*")
        if path.is_file()
        and path.suffix not in (".py", ".pyc")
        and "python" in path.read_text(encoding="utf-8").split("\n", 1)[0]
    ]
    assert not unseen


def test_hooks_ask_what_the_test_script_asks() -> None:
    hooks = {hook["id"]: hook for hook in of_yaml(".pre-commit-config.yaml")["repos"][0]["hooks"]}
    asked = re.findall(r"^    check (.+)$", text("scripts/test"), re.MULTILINE)
    assert {hook["entry"] for hook in hooks.values() if hook["language"] == "system"} < set(asked)


@pytest.mark.parametrize(("length", "refused"), [(72, False), (73, True)])
def test_a_hook_bounds_the_subject_alone(length: int, refused: bool) -> None:
    hooks = {hook["id"]: hook for hook in of_yaml(".pre-commit-config.yaml")["repos"][0]["hooks"]}
    message = f"{'s' * length}\n\n{'b' * 99}\n"
    assert bool(re.search(hooks["subject"]["entry"], message, re.MULTILINE)) is refused


def test_the_workflow_runs_what_ci_runs_and_what_the_readme_tells() -> None:
    jobs = of_yaml(".github/workflows/ci.yml")["jobs"]
    run = {name: [step["run"] for step in job["steps"] if "run" in step] for name, job in jobs.items()}
    assert run["everything"][-1] == ".ci/run"
    (command,) = [line for line in text("README.md").splitlines() if line.endswith("pytest")]
    assert run["newcomer"] == [command]
    known = [c.rsplit(" ", 1)[1] for c in SETTINGS["project"]["classifiers"] if " :: 3." in c]
    assert jobs["newcomer"]["strategy"]["matrix"]["python"] == known


def test_what_to_cite_is_what_the_project_says_of_itself() -> None:
    cited = of_yaml("CITATION.cff")
    project = SETTINGS["project"]
    assert (cited["title"], cited["license"]) == (project["name"], project["license"])
    assert cited["authors"] == project["authors"]
    assert cited["authors"][0]["name"] in text("LICENSE")
    (paper,) = cited["references"]
    assert paper["doi"] in text("docs/explanation/needle-model.md")
    assert paper["title"] in text("README.md").replace("\n", " ")
