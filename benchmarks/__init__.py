"""Benchmarks, each figure a ratio to peers measured in the same run; `python -m benchmarks` writes docs/benchmarks.md."""
