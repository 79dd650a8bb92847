"""Campaigns: a matrix of operating points as data, measured point by point, live or by the engine alone."""
