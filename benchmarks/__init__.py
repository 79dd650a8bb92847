"""Benchmarks, each figure beside peers measured in the same run; `python -m benchmarks` writes docs/benchmarks.md."""
