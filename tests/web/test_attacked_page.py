"""What an attack from outside looks like to a person at the page: a sentence there, and work that goes on."""

from __future__ import annotations

import re
import shutil
import subprocess
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from needle_rig.web.bounds import memory_bytes
from needle_rig.web.store import opened
from tests.closed_loop.shell import Shell
from tests.web.conftest import started
from tests.web.looking import IN_BROWSER, Open
from tests.web.served import Served
from tests.web.test_bounds import claim_every_cell
from tests.web.test_sources import MANY, recorded

playwright = pytest.importorskip("playwright.sync_api", reason="no playwright here: pip install playwright")
expect = playwright.expect
pytestmark = IN_BROWSER

HANGS_S = 10.0
"""A list that asks for something of each run takes longer, on a machine that has other work, too."""
"""On a machine that has a core for each that wants one; browser and server share it with others else."""
SMALL_DISK = ("unshare", "-Urm", "sh", "-c", 'mount -t tmpfs -o size=40m tmpfs "$0" && exec "$@"')


def dropped(page: Any, path: Path) -> None:
    page.get_by_label("choose files").set_input_files(path)


def still_works(page: Any) -> None:
    """The published data are compared as ever."""
    page.get_by_role("radio", name="reed2008").check()
    page.get_by_role("group", name="Residual map").wait_for()


def test_twenty_thousand_runs_do_not_hang_the_page(visit: Open, shell: Shell, tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    runs.mkdir()
    with opened(runs, tmp_path / "otherwise") as (store, _):
        recorded(runs, store)
    for served in started(shell, "--dir", str(runs)):
        page = visit("live", served=served)
        page.get_by_role("heading", name="No rig").wait_for()
        took_s = page.evaluate(
            """() => new Promise((done) => {
                const begun = performance.now();
                const seen = () => document.querySelector("table.runs tbody tr")
                    ? requestAnimationFrame(() => done((performance.now() - begun) / 1000))
                    : requestAnimationFrame(seen);
                location.hash = "#/runs";
                seen();
            })"""
        )
        assert took_s < HANGS_S
        assert page.get_by_text(f"{MANY}").first.is_visible()
        begun = page.locator("tbody tr").count()
        page.get_by_label("Filter").fill("run_19999")
        expect(page.locator("tbody tr")).to_have_count(1)
        assert begun > 1


@pytest.mark.skipif(shutil.which("unshare") is None, reason="no unshare here: apt-get install util-linux")
def test_a_full_disk_is_told_on_the_page_and_the_next_file_is_taken(
    visit: Open, shell: Shell, tmp_path: Path
) -> None:
    if subprocess.run([*SMALL_DISK, str(tmp_path), "true"], capture_output=True, check=False).returncode:
        pytest.skip("no file system can be mounted here without rights")
    (tmp_path / "large.csv").write_bytes(b"time,torque\n" + b"0.000000,1.000000\n" * (60 << 20 >> 4))
    (tmp_path / "small.csv").write_text("no table\n")
    runs = tmp_path / "runs"
    runs.mkdir()
    for served in started(shell, "--dir", str(runs), before=(*SMALL_DISK, str(runs))):
        page = visit("data", served=served)
        dropped(page, tmp_path / "large.csv")
        told = page.get_by_role("alert").filter(has_text="large.csv: cannot be written")
        told.wait_for(timeout=60_000)
        assert "No space left on device" in told.inner_text()
        assert "make room" in told.inner_text()
        dropped(page, tmp_path / "small.csv")
        page.get_by_role("radio", name="small.csv").wait_for(timeout=60_000)
        still_works(page)


def test_a_file_that_wants_more_memory_than_a_job_has_is_a_sentence_on_the_page(
    visit: Open, served: Served, tmp_path: Path
) -> None:
    header = {"descr": "<f8", "fortran_order": False, "shape": (memory_bytes() // 8 + 1_000_000,)}
    with (
        zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("torque.npy", "w") as file,
    ):
        np.lib.format.write_array_header_1_0(file, header)
        file.write(bytes(10 << 20))
    page = visit("data", served=served)
    dropped(page, tmp_path / "bomb.npz")
    told = page.get_by_role("alert").filter(has_text=re.compile("Unable to allocate|GB of memory"))
    told.wait_for(timeout=60_000)
    assert told.locator("span").inner_text().startswith("bomb.npz")
    still_works(page)


def test_a_sheet_that_claims_every_cell_is_a_sentence_on_the_page(
    visit: Open, served: Served, tmp_path: Path
) -> None:
    claim_every_cell(tmp_path / "far.xlsx")
    page = visit("data", served=served)
    dropped(page, tmp_path / "far.xlsx")
    told = page.get_by_role("alert").filter(has_text="GB of memory; give less data")
    told.wait_for(timeout=120_000)
    assert "RUST_BACKTRACE" not in told.inner_text()
    still_works(page)


def test_what_is_malformed_is_a_sentence_on_the_page(visit: Open, served: Served) -> None:
    page = visit("strategies", served=served)
    run = page.get_by_role("button", name="Run every strategy")
    page.get_by_label("Targets / °").fill("1e400")
    run.click()
    page.get_by_role("alert").filter(has_text="targets: give 1 to").wait_for(timeout=10_000)
    page.get_by_label("Targets / °").fill("45")
    # the field itself bounds it; a page that was changed does not
    page.get_by_label("Runs of each kind").evaluate("field => field.removeAttribute('max')")
    page.get_by_label("Runs of each kind").fill("1000000000")
    run.click()
    page.get_by_role("alert").filter(has_text="runs of each kind").wait_for(timeout=10_000)
    answers = page.evaluate(
        """async (bodies) => {
            const headers = {"X-Needle-Rig-Page": localStorage.getItem("needle-rig-page")};
            const answered = [];
            for (const [path, body] of bodies) {
                const answer = await fetch(path, {method: "POST", headers, body});
                answered.push([answer.status, typeof (await answer.json()).error]);
            }
            return answered;
        }""",
        [
            ["/api/estimate", "[["],
            [
                "/api/jobs",
                '{"kind": "strategies", "targets_deg": [true], "seeds": true, "parameters": ["x"]}',
            ],
            ["/api/lesson", '{"effect": "tip_friction", "values": {"torque_nmm": 1' + "0" * 400 + "}}"],
            ["/api/jobs", "[" * 60_000],
        ],
    )
    assert answers == [[422, "string"]] * 4
