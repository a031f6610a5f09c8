"""Recordings that are dropped on the page: what is what, confirmed and imported; their shaft in Learn."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from needle_rig.dataset import read_dataset
from needle_rig.units import deg, nmm
from tests.importing.machines import Joint, swings
from tests.web.looking import EVIL, IN_BROWSER, Open, look_at, pictured

playwright = pytest.importorskip("playwright.sync_api", reason="no playwright here: pip install playwright")
pytestmark = IN_BROWSER

LAYOUT = """\
needle: {diameter_mm: 0.39, shear_modulus_gpa: 27.2, density_g_cm3: 6.45}
needle_length_mm: 397
tissue_sections_mm: [[175, 200], [240, 265], [305, 330], [370, 395]]
hall_sensors:
  - {name: hall_1, position_mm: 220}
"""


LOGS = itertools.count()


@pytest.fixture
def log(data: Path, tmp_path: Path) -> Path:
    """One trial of the data as a logger of another laboratory writes it, with a column that is an attack."""
    dataset = read_dataset(data / "mine")
    trial = dataset.trials[0]
    columns = [
        trial.trial.time_s * 1e3,
        deg(trial.trial.base_angle_rad),
        nmm(trial.torque_nm),
        deg(trial.hall_rad[:, 0]),
        # no two tests drop the same file: the server keeps what was answered of it
        np.full(len(trial.torque_nm), float(next(LOGS))),
    ]
    path = tmp_path / "log.csv"
    head = f"t [ms];theta_base [deg];Mz [mNm];hall_1 [deg];{EVIL}"
    np.savetxt(path, np.column_stack(columns), fmt="%.6f", delimiter=";", header=head, comments="")
    return path


def test_a_recording_is_dropped_its_columns_confirmed_and_the_model_held_against_it(
    visit: Open, log: Path
) -> None:
    page = visit("data")
    page.get_by_label("choose files").set_input_files(log)
    page.get_by_role("heading", name="assign the columns of log.csv").wait_for()
    assert page.get_by_label("theta_base [deg] is").input_value() == "base_angle"
    assert page.get_by_label("Mz [mNm] is").input_value() == "base_torque"
    page.get_by_text("no layout is given").first.wait_for()
    page.get_by_label("looks like that of").select_option("written here")
    page.get_by_label("The shaft in lines of YAML").fill(LAYOUT)
    page.get_by_role("button", name="Propose again").click()
    page.get_by_text("no layout is given").wait_for(state="detached")
    page.wait_for_selector("[aria-label='What is what'] canvas")
    assert page.evaluate("window.evil") is None
    pictured(page, "what-is-what", "[aria-label='What is what']")
    look_at(page, "what-is-what")
    for doubt in page.locator(".doubt input").all():
        doubt.check()
    page.get_by_role("button", name="Import").click()
    page.wait_for_selector(".map")
    assert page.get_by_text("imported", exact=True).is_visible()
    assert page.get_by_text("hall 1").first.is_visible()


def test_the_kind_of_machine_is_chosen_where_no_layout_is_dropped(visit: Open, tmp_path: Path) -> None:
    joint = Joint()
    time_s, angle, rate = swings()
    torque = joint.torque_nm(angle, rate, np.random.default_rng(next(LOGS)))
    rows = np.column_stack((time_s, deg(angle), torque))
    file = tmp_path / "joint.csv"
    np.savetxt(file, rows, fmt="%.6f", delimiter=",", header="time [s],drive [deg],Torque [Nm]", comments="")
    page = visit("data")
    page.get_by_label("choose files").set_input_files(file)
    page.get_by_role("heading", name="assign the columns of joint.csv").wait_for()
    page.get_by_text("by the channels it is a joint").first.wait_for()
    page.get_by_label("looks like that of").select_option("shaft")
    page.get_by_role("button", name="Propose again").click()
    page.get_by_text("a shaft with gears or couplings between two machines: ").wait_for()
    page.get_by_text("no layout is given").wait_for(state="detached")
    assert page.get_by_label("looks like that of").input_value() == "machine:shaft"
    for doubt in page.locator(".doubt input").all():
        doubt.check()
    page.get_by_role("button", name="Import").click()
    page.wait_for_selector(".map")
    assert page.get_by_text("joint", exact=False).first.is_visible()
    assert not page.get_by_role("alert").count()


def test_what_cannot_be_imported_is_a_sentence_and_the_lines_stay(visit: Open, log: Path) -> None:
    page = visit("data")
    page.get_by_label("choose files").set_input_files(log)
    page.get_by_label("looks like that of").select_option("written here")
    page.get_by_label("The shaft in lines of YAML").fill(LAYOUT)
    page.get_by_role("button", name="Propose again").click()
    page.get_by_text("no layout is given").wait_for(state="detached")
    page.get_by_label("Unit of theta_base [deg]").fill("rad")
    page.get_by_label("Unit of theta_base [deg]").press("Tab")
    for doubt in page.locator(".doubt input").all():
        doubt.check()
    page.get_by_role("button", name="Import").click()
    page.get_by_role("alert").wait_for()
    assert "Traceback" not in page.get_by_role("alert").first.inner_text()
    assert page.get_by_label("Unit of theta_base [deg]").input_value() == "rad"


def test_a_mapping_that_names_other_files_is_refused(visit: Open, tmp_path: Path) -> None:
    mapping = tmp_path / "m.yaml"
    mapping.write_text(
        "format: needle-rig-import/1\nname: other\n"
        "clocks:\n  log: {files: [{path: ../../../../etc/passwd}], rate_hz: 10}\n"
        "channels:\n  - {role: base_angle, clock: log, source: a, unit: deg}\n"
    )
    page = visit("data")
    page.get_by_label("choose files").set_input_files(mapping)
    page.get_by_role("alert").filter(has_text="none of the dropped files").wait_for()


def test_the_sliders_draw_the_shaft_of_ones_own_data(visit: Open) -> None:
    page = visit("effects")
    page.get_by_role("link", name="tissue elasticity").click()
    page.get_by_text("on the experiment's layout").wait_for()
    page.get_by_label("On the shaft of").select_option(label="data/mine")
    page.get_by_text("on the layout of mine, with the noise of its channels").wait_for()
    page.wait_for_selector(".plot canvas")
