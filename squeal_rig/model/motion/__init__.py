"""The motion of the pad in time: engines, trajectories, ensembles."""
