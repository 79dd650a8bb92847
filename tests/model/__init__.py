"""Tests of the pure physics: published and analytic cases, an independent reference, properties."""
