"""What a rig can measure: channels, drivers, acquisition block by block."""
