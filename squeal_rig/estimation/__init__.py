"""What the measured channels tell: friction, its law, squeal, spectra."""
