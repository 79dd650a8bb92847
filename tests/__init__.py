"""Tests, in the folders of the package; what several folders share lies here."""
