"""The paper's results computed from the preset and laid beside the printed numbers."""
