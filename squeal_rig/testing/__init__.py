"""For whoever builds a driver or a rig: the driver contract suite, and a twin of the hardware."""
