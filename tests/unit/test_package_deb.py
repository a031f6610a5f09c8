"""The Debian package has what it must have; what it installs runs, also for who may not write there."""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from needle_rig.version import VERSION

ROOT = Path(__file__).parents[2]
HOME = Path("usr/lib/needle-rig")
NOBODY = 65534

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(1200),
    pytest.mark.skipif(shutil.which("dpkg-deb") is None, reason="no dpkg-deb"),
    pytest.mark.skipif(not Path("/usr/bin/python3").exists(), reason="no Python of the system's"),
]


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    """A folder that every user may look into."""
    with tempfile.TemporaryDirectory(prefix="needle-rig-deb-") as made:
        Path(made).chmod(0o755)
        yield Path(made)


@pytest.fixture(scope="module")
def package(folder: Path) -> Path:
    subprocess.run([ROOT / "scripts/package-deb", folder], check=True, capture_output=True, text=True)
    (made,) = folder.glob("*.deb")
    return made


@pytest.fixture(scope="module")
def tree(package: Path, folder: Path) -> Path:
    """What it puts on a computer."""
    subprocess.run(["dpkg-deb", "--extract", package, folder / "root"], check=True)
    return folder / "root"


def test_it_says_what_it_is_and_what_it_needs(package: Path) -> None:
    def field(name: str) -> str:
        done = subprocess.run(
            ["dpkg-deb", "--field", package, name], check=True, capture_output=True, text=True
        )
        return done.stdout.strip()

    assert (field("Package"), field("Version")) == ("needle-rig", VERSION)
    assert package.name == f"needle-rig_{VERSION}_{field('Architecture')}.deb"
    assert field("Depends").startswith("python3.")


def test_it_holds_command_unit_rules_and_account_and_belongs_to_root(package: Path, tree: Path) -> None:
    listed = subprocess.run(["dpkg-deb", "--contents", package], check=True, capture_output=True, text=True)
    lines = [line.split(maxsplit=5) for line in listed.stdout.splitlines()]
    assert {line[1] for line in lines} == {"root/root"}
    assert not [line for line in lines if line[0][0] != "l" and "w" in line[0][4:]], "root alone may write"
    unit = (tree / "usr/lib/systemd/system/needle-rig.service").read_text()
    assert f"Environment=PATH=/{HOME}/bin:" in unit
    assert (tree / "usr/lib/systemd/system/needle-rig-failed@.service").is_file()
    assert "u needle-rig" in (tree / "usr/lib/sysusers.d/needle-rig.conf").read_text()
    assert "dialout" in (tree / "usr/lib/udev/rules.d/70-needle-rig.rules").read_text()
    assert os.readlink(tree / "usr/bin/needle-rig") == "../lib/needle-rig/bin/needle-rig"
    outside = {path.parts[0] for path in (p.relative_to(tree) for p in tree.rglob("*"))}
    assert outside == {"usr"}, "what an administrator keeps is not touched"


def test_nothing_in_it_tells_where_it_was_built(tree: Path) -> None:
    texts = [path for path in (tree / HOME / "bin").iterdir() if path.is_file() and not path.is_symlink()]
    texts += [
        tree / HOME / "pyvenv.cfg",
        *(tree / HOME / "lib").glob("python3*/site-packages/*/direct_url.json"),
    ]
    assert not [path for path in texts if b"/tmp/" in path.read_bytes() or bytes(ROOT) in path.read_bytes()]
    first, *_ = (tree / HOME / "bin/needle-rig").read_text().splitlines()
    assert first == f"#!/{HOME}/bin/python"
    assert not list(tree.rglob("*.pyc"))


def test_its_scripts_are_shell(package: Path, folder: Path) -> None:
    subprocess.run(["dpkg-deb", "--control", package, folder / "control"], check=True)
    for name in ("postinst", "prerm", "postrm"):
        script = folder / "control" / name
        assert script.stat().st_mode & stat.S_IXUSR
        subprocess.run(["sh", "-n", script], check=True)


def needle_rig(
    tree: Path, home: Path, *words: str, home_said: str | None = None
) -> subprocess.CompletedProcess[str]:
    """The installed command, as a user who may not write to the installation."""
    command = [*map(str, (tree / HOME / "bin/python", tree / HOME / "bin/needle-rig")), *words]
    if os.geteuid() == 0:
        command = ["setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups", *command]
    return subprocess.run(
        command,
        cwd=home,
        env={"PATH": "/usr/bin:/bin", "HOME": home_said or str(home), "LC_ALL": "C.UTF-8"},
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )


@pytest.fixture
def home(folder: Path) -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="home", dir=folder) as made:
        if os.geteuid() == 0:
            os.chown(made, NOBODY, NOBODY)
        yield Path(made)


def written(tree: Path) -> set[Path]:
    return set(tree.rglob("*"))


def test_the_installed_command_tells_its_version(tree: Path, home: Path) -> None:
    told = needle_rig(tree, home, "--version")
    assert told.stdout == f"needle-rig, version {VERSION}\n", told.stderr


COMPENSATE = (
    "compensate",
    "--target",
    "5",
    "--strategy",
    "none",
    "--fast",
    "--no-picture",
    "--settle",
    "0.5",
)


def test_compiled_code_is_kept_for_a_user_who_may_not_write_beside_the_package(
    tree: Path, home: Path
) -> None:
    if os.geteuid() != 0:
        subprocess.run(["chmod", "-R", "a-w", tree / HOME], check=True)
    before = written(tree)
    first = needle_rig(tree, home, *COMPENSATE)
    assert first.returncode == 0, first.stderr
    assert "cannot be kept" not in first.stderr
    kept = {path: path.stat().st_mtime_ns for path in (home / ".cache").rglob("*.nb[ic]")}
    assert kept, "in the user's own folder"
    second = needle_rig(tree, home, *COMPENSATE)
    assert second.returncode == 0, second.stderr
    again = {path: path.stat().st_mtime_ns for path in (home / ".cache").rglob("*.nb[ic]")}
    assert again == kept, "nothing is compiled a second time"
    assert written(tree) == before


def test_a_user_without_a_home_compiles_anew_and_is_told_so_once(tree: Path, home: Path) -> None:
    done = needle_rig(tree, home, *COMPENSATE, home_said="/nonexistent")
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("compiled code cannot be kept") == 1
    assert "Traceback" not in done.stderr
