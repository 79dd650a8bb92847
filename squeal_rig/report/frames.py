"""The readers for notebooks under their public name; they live in `squeal_rig.samples.frames`."""

from squeal_rig.samples.frames import read_array, read_frame, read_table

__all__ = ["read_array", "read_frame", "read_table"]
