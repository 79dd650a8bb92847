"""Facts about the whole: the command `squeal-rig` as a user runs it."""
