"""Recorder and player as processes."""
