"""The law, the forces and the static equilibrium, on one packed layout of the parameters."""
