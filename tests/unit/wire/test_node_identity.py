"""What a node says of itself is kept while it holds, and decides whether the node is worked with."""

from __future__ import annotations

from needle_rig.config.files import find_config_file
from needle_rig.records import Firmware
from needle_rig.version import VERSION
from needle_rig.wire.can_frames import CanCodec, NodeCalibration, NodeFirmware
from needle_rig.wire.node_identity import FORGOTTEN_S, NodeIdentity

CODEC = CanCodec(find_config_file("needle_rig.dbc"))
(KNOWN,) = CODEC.protocols
UNKNOWN = KNOWN + 1
FIRMWARE = NodeFirmware("drive", KNOWN, "0.2.0", 0xABCDEF, 0)
CALIBRATION = NodeCalibration("drive", KNOWN, 7, 0)


def identity() -> NodeIdentity:
    return NodeIdentity(CODEC, "drive")


def test_both_frames_together_are_what_is_told() -> None:
    node = identity()
    assert node.told(0.0) == Firmware()
    node.take(FIRMWARE, 1.0)
    assert node.told(1.0) == Firmware(KNOWN, "0.2.0", 0xABCDEF)
    node.take(CALIBRATION, 1.5)
    assert node.told(1.5) == Firmware(KNOWN, "0.2.0", 0xABCDEF, True, 7)
    node.take(CALIBRATION._replace(serial=None), 2.5)
    assert node.told(2.5) == Firmware(KNOWN, "0.2.0", 0xABCDEF, False, None)


def test_frames_of_the_other_node_say_nothing() -> None:
    node = identity()
    node.take(FIRMWARE._replace(node="torque", protocol=UNKNOWN), 1.0)
    node.take(CALIBRATION._replace(node="torque"), 1.0)
    node.take(None, 1.0)
    assert node.told(1.0) == Firmware()


def test_what_a_node_ceased_to_say_is_forgotten() -> None:
    """An older firmware was flashed meanwhile, which says nothing of itself."""
    node = identity()
    node.take(FIRMWARE, 1.0)
    assert node.told(1.0 + FORGOTTEN_S).version == "0.2.0"
    assert node.told(1.01 + FORGOTTEN_S) == Firmware()


def test_either_frame_of_an_unknown_protocol_is_enough_to_refuse_in_a_sentence() -> None:
    for frame in (FIRMWARE, CALIBRATION):
        node = identity()
        node.take(frame._replace(protocol=UNKNOWN), 1.0)
        assert node.refusal.startswith(f"the drive node speaks protocol {UNKNOWN}")
        assert f"needle-rig {VERSION} knows {KNOWN}; flash" in node.refusal
        assert node.told(1.0).refusal == node.refusal


def test_a_refusal_outlasts_silence_and_ends_with_a_known_protocol() -> None:
    node = identity()
    node.take(FIRMWARE, 0.0)
    node.take(CALIBRATION, 0.5)
    node.take(CALIBRATION._replace(protocol=UNKNOWN), 1.0)
    told = node.told(1.0)
    assert (told.protocol, told.version, told.calibration_serial) == (UNKNOWN, None, 7)
    assert node.told(1e6).refusal
    node.take(CALIBRATION, 1e6)
    assert node.told(1e6) == Firmware(KNOWN, None, None, True, 7)
