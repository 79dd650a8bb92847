"""The linear model: eigenvalues, critical stiffness, maps."""
