"""Samples out of bags: blocks joined, columns, files of other tools."""
