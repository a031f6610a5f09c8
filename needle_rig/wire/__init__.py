"""Bytes on the wire and what they mean: CAN frames of the DBC, serial frames of the Hall node."""
