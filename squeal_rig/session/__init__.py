"""A running session: nodes as processes, the live console, the demo."""
