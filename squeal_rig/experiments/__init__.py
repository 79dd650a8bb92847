"""Experiments: plans as data, and the engine that runs them against a rig."""
