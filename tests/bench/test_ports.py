"""Opening a rig: what a person is told when a port or a node is not there."""

from __future__ import annotations

import asyncio
import math
import os

import pytest

from needle_rig.config.loader import load_rig_config
from needle_rig.config.schema import RigConfig
from needle_rig.devices.hardware_rig import HardwareRig
from needle_rig.errors import BadInput, NeedleRigError
from needle_rig.simulation.bench.process import Bench


def refusal(config: RigConfig, timeout_s: float = 3.0) -> NeedleRigError:
    async def scenario() -> NeedleRigError:
        rig = HardwareRig(config)
        with pytest.raises(NeedleRigError) as caught:
            await rig.open(timeout_s)
        await rig.close()
        return caught.value

    error = asyncio.run(scenario())
    assert "\n" not in str(error)
    assert error.exit_code in (2, 3)
    return error


def changed(config: RigConfig, **links: object) -> RigConfig:
    """`config` with other values in its links, as `can__channel="…"`."""
    data = config.model_dump()
    for path, value in links.items():
        section, key = path.split("__")
        data["links"][section][key] = value
    return RigConfig.model_validate(data)


def test_every_link_gives_fresh_values(config: RigConfig) -> None:
    rows: dict[str, list[tuple[float, ...]]] = {}

    async def scenario() -> None:
        rig = HardwareRig(config, lambda source, row: rows.setdefault(source, []).append(row))
        await rig.open()
        measurement = rig.read()
        await rig.close()
        assert max(measurement.torque_age_s, measurement.hall_age_s, measurement.drive_age_s) < 1.0
        assert len(measurement.hall_rad) == 4
        values = (measurement.base_angle_rad, measurement.torque_nm, *measurement.hall_rad)
        assert all(math.isfinite(value) for value in values)

    asyncio.run(scenario())
    assert {source: len(of_source[0]) for source, of_source in rows.items()} == {
        "torque": 4,
        "hall": 7,
        "drive": 6,
    }


def test_a_can_port_that_does_not_exist(config: RigConfig) -> None:
    error = refusal(changed(config, can__channel="/dev/ttyNOTHERE"))
    assert "CAN bus (slcan /dev/ttyNOTHERE): there is no /dev/ttyNOTHERE" in str(error)


def test_a_hall_port_that_does_not_exist(config: RigConfig) -> None:
    error = refusal(changed(config, hall__port="/dev/ttyNOTHERE"))
    assert "Hall link (/dev/ttyNOTHERE): there is no /dev/ttyNOTHERE" in str(error)


def test_a_socketcan_interface_that_does_not_exist(config: RigConfig) -> None:
    error = refusal(changed(config, can__interface="socketcan", can__channel="can97"))
    assert str(error).startswith("CAN bus (socketcan can97): ")


def test_a_port_that_is_no_terminal(config: RigConfig, tmp_path: object) -> None:
    assert "Hall link (/dev/null)" in str(refusal(changed(config, hall__port="/dev/null")))
    assert "CAN bus (slcan /dev/null)" in str(refusal(changed(config, can__channel="/dev/null")))


@pytest.mark.skipif(os.geteuid() == 0, reason="root may open every port")
def test_a_port_without_the_right_to_open_it(config: RigConfig) -> None:
    assert "dialout" in str(refusal(changed(config, hall__port="/dev/console")))


def test_a_bit_rate_that_slcan_does_not_know(config: RigConfig) -> None:
    assert "bitrate" in str(refusal(changed(config, can__bitrate_kbit_s=333)))


def test_a_second_instance_on_the_same_ports_leaves_the_first_alone(config: RigConfig) -> None:
    async def scenario() -> None:
        first = HardwareRig(config)
        await first.open()
        for half in (config, changed(config, can__interface="virtual", can__channel="elsewhere")):
            second = HardwareRig(half)
            with pytest.raises(NeedleRigError, match="in use by another program") as caught:
                await second.open()
            assert "\n" not in str(caught.value)
        assert first.read().torque_age_s < 1.0
        await first.close()
        third = HardwareRig(config)
        await third.open()
        await third.close()

    asyncio.run(scenario())


@pytest.mark.parametrize(
    ("link", "named"), [("torque", "torque link"), ("drive", "drive link"), ("hall", "Hall link")]
)
def test_a_node_that_is_silent_at_the_start_is_named_with_its_port(
    bench: Bench, config: RigConfig, link: str, named: str
) -> None:
    bench.harm(link, "silence")
    error = refusal(config, timeout_s=0.3)
    port = config.links.ports["hall.port" if link == "hall" else "can.channel"]
    assert named in str(error)
    assert port in str(error)
    assert str(error).count("link (") == 1


def test_a_node_with_another_number_of_sensors_is_told(config: RigConfig) -> None:
    data = config.model_dump()
    data["layout"]["hall_sensors"] = data["layout"]["hall_sensors"][:3]
    error = refusal(RigConfig.model_validate(data), timeout_s=0.3)
    assert "4 sensors are sent, layout.hall_sensors has 3" in str(error)


def test_auto_ports_without_a_bench_are_refused() -> None:
    with pytest.raises(BadInput, match=r"links\.can\.channel: auto"):
        HardwareRig(load_rig_config())
