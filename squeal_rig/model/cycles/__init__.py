"""Squeal cycles: found, followed and judged on the exact flow, offline."""
