from needle_rig.config.loader import find_config_file, load_rig_config
from needle_rig.config.schema import SerialSection
from needle_rig.devices.hardware_rig import HardwareRig
from needle_rig.simulation.bench.process import needs_bench


def test_the_shipped_hardware_file_makes_a_rig_without_a_bench() -> None:
    config = load_rig_config(find_config_file("rig.hardware.yaml"))
    assert config.kind == "hardware"
    assert not needs_bench(config)
    HardwareRig(config)


def test_the_serial_line_carries_the_hall_frames_at_1_khz() -> None:
    config = load_rig_config(find_config_file("rig.hardware.yaml"))
    bytes_a_frame = 2 + 8 + 6 * len(config.layout.hall_sensors) + 2
    hall = config.links.hall
    assert isinstance(hall, SerialSection)
    assert bytes_a_frame * 10 * 1000 < 0.5 * hall.baud
